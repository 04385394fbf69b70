//! The scripts of `bench/peers`, unpacked for a run.

use std::path::{Path, PathBuf};
use std::process::Command;

use super::child;

/// Scripts: see `bench/peers/README.md` for their origin.
const SCRIPTS: [(&str, &str); 6] = [
    ("common.py", include_str!("../../../bench/peers/common.py")),
    ("field_baseline.py", include_str!("../../../bench/peers/field_baseline.py")),
    ("numpy_cpcm.py", include_str!("../../../bench/peers/numpy_cpcm.py")),
    ("site_job.py", include_str!("../../../bench/peers/site_job.py")),
    ("t1_opensees.py", include_str!("../../../bench/peers/t1_opensees.py")),
    ("whole_job.py", include_str!("../../../bench/peers/whole_job.py")),
];

/// Displacement of 100 passages with known force.
const PASSAGES: &[u8] = include_bytes!("../../../tests/data/reference/cpcm_passages_soft.parquet");

/// A directory with the scripts, removed at the end.
pub struct Peers {
    dir: tempfile::TempDir,
    python: String,
}

impl Peers {
    /// Unpacks the scripts; `python` runs them.
    pub fn unpack(python: &str) -> std::io::Result<Self> {
        let dir = tempfile::tempdir()?;
        for (name, text) in SCRIPTS {
            std::fs::write(dir.path().join(name), text)?;
        }
        std::fs::create_dir(dir.path().join("results"))?;
        std::fs::write(dir.path().join("passages.parquet"), PASSAGES)?;
        Ok(Self { dir, python: python.to_owned() })
    }

    /// The passages.
    pub fn passages(&self) -> PathBuf {
        self.dir.path().join("passages.parquet")
    }

    /// What has to be installed before a script with these modules runs; `None` when nothing is missing.
    pub fn missing(&self, modules: &[&str]) -> Option<String> {
        let mut alone = Command::new(&self.python);
        if let Err(error) = child::measure(alone.arg("--version")) {
            return Some(format!(
                "{error}; install Python 3 (Debian: apt-get install python3), or name it with --python"
            ));
        }
        let absent: Vec<&str> = modules
            .iter()
            .filter(|m| {
                child::measure(Command::new(&self.python).arg("-c").arg(format!("import {m}"))).is_err()
            })
            .map(|m| m.split('.').next().unwrap_or(m))
            .collect();
        match absent.as_slice() {
            [] => None,
            names => {
                // Installed without the system's BLAS it does not import either, and does not say why.
                let blas = if names.contains(&"openseespy") {
                    "; it needs libblas3 (Debian: apt-get install libblas3)"
                } else {
                    ""
                };
                Some(format!("{} -m pip install {}{blas}", self.python, names.join(" ")))
            }
        }
    }

    /// A run of a script with one BLAS thread: its CPU time then is that of the work, not of waiting threads.
    pub fn command(&self, script: &str, arguments: &[&Path]) -> Command {
        let mut command = Command::new(&self.python);
        command.current_dir(self.dir.path()).arg(script).args(arguments);
        for variable in ["OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"] {
            command.env(variable, "1");
        }
        command
    }
}
