//! A child process and what it used.

use std::process::{Command, Stdio};
use std::time::Instant;

use wait4::Wait4 as _;

/// What one run of a program used.
#[derive(Clone, Debug, PartialEq)]
pub struct Usage {
    /// User and system time of all threads, s.
    pub cpu_s: f64,
    /// Elapsed time, s.
    pub wall_s: f64,
    /// Largest resident set, MiB.
    pub peak_mib: f64,
    /// Last line on standard output.
    pub answer: String,
}

/// Why a program has no usage.
#[derive(Debug, thiserror::Error)]
pub enum ChildError {
    /// It could not be started or waited for.
    #[error("cannot run {program}: {reason}")]
    Start {
        /// Program.
        program: String,
        /// From the operating system.
        reason: std::io::Error,
    },
    /// It ended with a failure.
    #[error("{program} failed: {last}")]
    Failed {
        /// Program.
        program: String,
        /// Last line on standard error.
        last: String,
    },
}

const MIB: f64 = 1024.0 * 1024.0;

/// Runs a command to its end.
pub fn measure(command: &mut Command) -> Result<Usage, ChildError> {
    let program = command.get_program().to_string_lossy().into_owned();
    let failed = |reason| ChildError::Start { program: program.clone(), reason };
    let begin = Instant::now();
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = command.spawn().map_err(failed)?;
    let (out, error) = (child.stdout.take(), child.stderr.take());
    // Both pipes are read at once: a child that fills one of them would wait for ever.
    let errors = std::thread::spawn(move || text(error));
    let output = text(out);
    let used = child.wait4().map_err(failed)?;
    let wall_s = begin.elapsed().as_secs_f64();
    let errors = errors.join().unwrap_or_default();
    if !used.status.success() {
        return Err(ChildError::Failed { program, last: last_line(&errors) });
    }
    Ok(Usage {
        cpu_s: (used.rusage.utime + used.rusage.stime).as_secs_f64(),
        wall_s,
        peak_mib: used.rusage.maxrss as f64 / MIB,
        answer: last_line(&output),
    })
}

/// Everything a pipe holds, as far as it is text.
fn text(pipe: Option<impl std::io::Read>) -> String {
    let mut bytes = Vec::new();
    if let Some(mut pipe) = pipe {
        // What was read before an error still tells what happened.
        let _ = pipe.read_to_end(&mut bytes);
    }
    String::from_utf8_lossy(&bytes).into_owned()
}

fn last_line(text: &str) -> String {
    text.trim_end().lines().next_back().unwrap_or("no message").to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn property_usage_belongs_to_the_child_and_failure_has_its_words() {
        let used = measure(Command::new("sh").args(["-c", "echo first; echo last"])).unwrap();
        assert_eq!(used.answer, "last");
        assert!(used.peak_mib > 0.1 && used.cpu_s < 5.0);
        let failed = measure(Command::new("sh").args(["-c", "echo why >&2; exit 3"])).unwrap_err();
        assert_eq!(failed.to_string(), "sh failed: why");
        let missing = measure(&mut Command::new("no-such-program-anywhere")).unwrap_err();
        assert!(missing.to_string().starts_with("cannot run no-such-program-anywhere"));
    }
}
