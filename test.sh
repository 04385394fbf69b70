#!/bin/sh
# Everything that can be checked without hardware: format, lints, documentation, tests on the computer, the firmware of
# both boards, the firmware in QEMU. Stops at the first failure. Needs rustup; installs the target and QEMU where it may.
set -eu
cd "$(dirname "$0")"

begin=$(date +%s)
step() { printf '\n== %s (after %s s)\n' "$1" "$(($(date +%s) - begin))"; }

# A package of Debian's, where this may install one.
install() {
    command -v apt-get >/dev/null || return 1
    if [ "$(id -u)" = 0 ]; then
        sudo=
    elif sudo -n true 2>/dev/null; then
        sudo=sudo
    else
        return 1
    fi
    $sudo apt-get update && $sudo apt-get install --yes --no-install-recommends "$1"
}

step "tools"
rustup target add thumbv7em-none-eabihf
if ! command -v qemu-system-arm >/dev/null && ! install qemu-system-arm; then
    echo "qemu-system-arm (7.2 or later) is missing and cannot be installed from here. Install it and run again:" >&2
    echo "  Debian, Ubuntu: apt-get install qemu-system-arm;  Fedora: dnf install qemu-system-arm;  macOS: brew install qemu" >&2
    exit 1
fi
# A test has bench/closed_fraction.py recompute what a diagnosis states.
CPCM_PYTHON=${CPCM_PYTHON:-python3}
if ! "$CPCM_PYTHON" -c 'import numpy, pyarrow.parquet' 2>/dev/null; then
    CPCM_PYTHON="$PWD/target/python/bin/python3"
    python3 -m venv target/python || { install python3-venv && python3 -m venv target/python; } || true
    if ! "$CPCM_PYTHON" -m pip install --quiet numpy pyarrow; then
        echo "Python 3 with numpy and pyarrow is missing and cannot be installed from here. Install them and run again:" >&2
        echo "  python3 -m pip install numpy pyarrow, or name a Python that has both: CPCM_PYTHON=... sh test.sh" >&2
        exit 1
    fi
fi
export CPCM_PYTHON
"$CPCM_PYTHON" --version
rustc --version
qemu-system-arm --version | head -n 1

step "format"
cargo fmt --all --check

# The images keep one core busy most of the time, and lints the other.
mkdir -p target
{ cargo fw && cargo fw-qemu; } >target/firmware.log 2>&1 &
images=$!
trap 'kill "$images" 2>/dev/null || true' EXIT

step "lints, and beside them the firmware"
# The benches as well, which plain commands leave out. Of the release profile, so that build scripts, procedural macros and zstd are
# compiled once for lints, documentation and tests.
cargo clippy --release --all-targets --workspace --exclude cpcm-node -- -D warnings
cargo clippy --release --package cpcm-shared --target thumbv7em-none-eabihf -- -D warnings
for board in stm32 qemu; do
    cargo clippy --release --package cpcm-node --target thumbv7em-none-eabihf --features "board-$board" -- -D warnings
done

step "documentation"
RUSTDOCFLAGS="-D warnings" cargo doc --release --no-deps --workspace --exclude cpcm-node

step "firmware: flash and RAM of both boards"
cargo test --release --no-run --package cpcm --package cpcm-tests --lib --test '*'
cargo build --release --package cpcm --bin cpcm
wait "$images" || { cat target/firmware.log >&2; exit 1; }
trap - EXIT
cargo test --release --package cpcm-tests --test firmware -- --nocapture

step "tests, and beside them the blind trials of the next step"
# Tests end one after another and leave a core idle then; the trials take what they leave, and what they need beyond that at the end.
rm -rf target/blind-trial
nice -n 10 cargo run --release --package cpcm --bin cpcm -- \
    blind-trial --seed 7 --trials 20 --check --out target/blind-trial >target/blind-trial.log 2>&1 &
trials=$!
trap 'kill "$trials" 2>/dev/null || true' EXIT
# What runs on the node, with its arithmetic and its assertions checked; of the release profile, whose dependencies are compiled anyway.
cargo test --release --package cpcm-shared --lib --no-fail-fast \
    --config 'profile.release.package.cpcm-shared.overflow-checks=true' \
    --config 'profile.release.package.cpcm-shared.debug-assertions=true'
# The library and whole-system tests, which call the program as users do: simulations and diagnoses take half the time of a build with
# checked arithmetic. Together, so that the two longest compilations share the cores.
cargo test --release --no-fail-fast --package cpcm --package cpcm-tests --lib --test '*'

step "blind trials: 20 withheld effects, scored"
wait "$trials" || { cat target/blind-trial.log >&2; exit 1; }
trap - EXIT
cat target/blind-trial.log

printf '\nall checks passed (%s s)\n' "$(($(date +%s) - begin))"
