#!/bin/sh
# Everything that can be checked without hardware: format, lints, documentation, tests on the computer, the firmware of
# both boards, the firmware in QEMU. Stops at the first failure. Needs rustup; installs the target and QEMU where it may.
set -eu
cd "$(dirname "$0")"

begin=$(date +%s)
step() { printf '\n== %s (after %s s)\n' "$1" "$(($(date +%s) - begin))"; }

step "tools"
rustup target add thumbv7em-none-eabihf
if ! command -v qemu-system-arm >/dev/null; then
    if command -v apt-get >/dev/null && [ "$(id -u)" = 0 ]; then
        apt-get update && apt-get install --yes --no-install-recommends qemu-system-arm
    elif command -v apt-get >/dev/null && sudo -n true 2>/dev/null; then
        sudo apt-get update && sudo apt-get install --yes --no-install-recommends qemu-system-arm
    else
        echo "qemu-system-arm (7.2 or later) is missing and cannot be installed from here. Install it and run again:" >&2
        echo "  Debian, Ubuntu: apt-get install qemu-system-arm;  Fedora: dnf install qemu-system-arm;  macOS: brew install qemu" >&2
        exit 1
    fi
fi
rustc --version
qemu-system-arm --version | head -n 1

step "format"
cargo fmt --all --check

step "lints"
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
# The images keep one core busy most of the time; what the tests need compiles beside them.
{ cargo fw && cargo fw-qemu; } >target/firmware.log 2>&1 &
images=$!
cargo test --release --no-run --package cpcm --package cpcm-tests --lib --test '*'
cargo build --release --package cpcm --bin cpcm
wait "$images" || { cat target/firmware.log >&2; exit 1; }
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
