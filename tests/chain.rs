//! The whole chain through the program, on a few passages of a field site: truth beside the recordings changes nothing,
//! and the host's kernel package gives the same records in the simulated node, in the ELF and after a download.
//!
//! Needs `qemu-system-arm`.

use std::fs;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Stdio};
use std::sync::OnceLock;

use cpcm::node_client::parse_records;
use cpcm::recording::{Format, read_site, write_site};
use cpcm_tests::elf;
use cpcm_tests::program::{cpcm, cpcm_command, succeeds};
use cpcm_tests::sample::field;
use tempfile::TempDir;

/// Which passages: enough for a calibration.
const PASSAGES: [usize; 4] = [0, 7, 13, 20];
const RESULTS: [&str; 6] =
    ["forces.parquet", "ballast.csv", "indicators.json", "modes.csv", "mean_irregularity.csv", "report.html"];

/// Recordings of [`PASSAGES`] without truth, in `parent/name`.
fn site(parent: &Path, name: &str) -> PathBuf {
    let mut site = read_site(&field("reference-1")).unwrap();
    site.passages = PASSAGES.map(|i| site.passages[i].clone()).to_vec();
    write_site(&parent.join(name), &site, Format::Parquet).unwrap();
    parent.join(name)
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// Results and kernel package beside the site.
fn evaluated(site: &Path) {
    let (results, kernel) = (site.with_extension("results"), site.with_extension("kernel"));
    succeeds(&["analyse", text(site), "--out", text(&results)]);
    succeeds(&["kernel", text(site), "--out", text(&kernel)]);
}

/// A site that knows nothing of the truth, with results and kernel.
fn bare() -> &'static Path {
    static BARE: OnceLock<(TempDir, PathBuf)> = OnceLock::new();
    let (_, site) = BARE.get_or_init(|| {
        let dir = tempfile::tempdir().unwrap();
        let site = site(dir.path(), "bare");
        evaluated(&site);
        (dir, site)
    });
    site
}

#[test]
fn property_results_do_not_depend_on_truth_or_directory() {
    let dir = tempfile::tempdir().unwrap();
    let spoilt = site(dir.path(), "elsewhere");
    fs::write(spoilt.join("truth.parquet"), "garbage").unwrap();
    fs::write(spoilt.join("truth.toml"), "stiffness_n_m2 = [1.0").unwrap();
    evaluated(&spoilt);
    let same =
        |file: &dyn Fn(&Path) -> PathBuf| fs::read(file(bare())).unwrap() == fs::read(file(&spoilt)).unwrap();
    for name in RESULTS {
        assert!(same(&|site| site.with_extension("results").join(name)), "{name}");
    }
    assert!(same(&|site| site.with_extension("kernel")), "kernel package");
}

/// A node that stays after `node simulate --listen`.
struct Listening(Child, String);

impl Listening {
    fn start(site: &Path, kernel: &Path, out: &Path) -> Self {
        let mut command = cpcm_command(&["node", "simulate", text(site), "--kernel", text(kernel)]);
        command.args(["--out", text(out), "--listen", "127.0.0.1:0"]).stdout(Stdio::piped());
        let mut child = command.spawn().unwrap();
        let lines = BufReader::new(child.stdout.take().unwrap()).lines();
        let address = lines
            .map_while(Result::ok)
            .find_map(|line| Some(line.split("--port ").nth(1)?.split(';').next()?.to_string()))
            .expect("the program tells its address");
        Listening(child, address)
    }
}

impl Drop for Listening {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn property_simulated_node_elf_and_download_give_the_same_files() {
    let (site, kernel) = (bare(), bare().with_extension("kernel"));
    let dir = tempfile::tempdir().unwrap();
    let out = |name: &str| dir.path().join(name);
    let elf = elf::build("fw-qemu", "node-qemu");
    let (program, qemu, downloaded) = (out("program"), out("qemu"), out("downloaded"));
    let node = Listening::start(site, &kernel, &program);
    succeeds(&["node", "download", "--port", &node.1, "--out", text(&downloaded)]);
    let simulate = ["node", "simulate", text(site), "--kernel", text(&kernel)];
    succeeds(&[&simulate[..], &["--qemu", "--elf", text(&elf), "--out", text(&qemu)]].concat());
    for name in ["records.bin", "records.parquet"] {
        let read = |dir: &Path| fs::read(dir.join(name)).unwrap();
        assert!(read(&program) == read(&qemu), "{name} in QEMU");
        assert!(read(&program) == read(&downloaded), "{name} downloaded");
    }
    let (records, _, fault) = parse_records(&fs::read(program.join("records.bin")).unwrap());
    assert_eq!((records.len(), fault), (PASSAGES.len(), None));
    for record in records {
        assert_eq!((record.wheelsets.len(), record.flags), (12, 0), "{record:?}");
    }
}

#[test]
fn property_node_refuses_a_damaged_package_and_says_why() {
    let dir = tempfile::tempdir().unwrap();
    let mut package = fs::read(bare().with_extension("kernel")).unwrap();
    let middle = package.len() / 2;
    package.truncate(middle);
    let kernel = dir.path().join("kernel.bin");
    fs::write(&kernel, package).unwrap();
    let out = dir.path().join("out");
    let run = cpcm(&["node", "simulate", text(bare()), "--kernel", text(&kernel), "--out", text(&out)]);
    let error = String::from_utf8_lossy(&run.stderr);
    assert_eq!(run.status.code(), Some(1), "{error}");
    assert!(error.contains("does not take the kernel package"), "{error}");
}
