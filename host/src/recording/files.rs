//! Small files: reading with a size limit, writing so that a reader never sees half a file.

use std::io::Write;
use std::path::{Path, PathBuf};

use super::RecordingError;

/// Largest text file read, bytes: a CSV recording of [`super::MAX_SAMPLES`] samples fits.
const MAX_TEXT_BYTES: u64 = 200 << 20;

/// Reads a text file. Bytes that are not UTF-8 become replacement characters, which no number and no key contains.
pub(crate) fn read_text(file: &Path) -> Result<String, RecordingError> {
    read_bytes(file).map(|bytes| String::from_utf8_lossy(&bytes).into_owned())
}

/// Reads a file of limited size.
pub(crate) fn read_bytes(file: &Path) -> Result<Vec<u8>, RecordingError> {
    let io = |source| RecordingError::Io { doing: "read", path: file.into(), source };
    let bytes = std::fs::metadata(file).map_err(io)?.len();
    if bytes > MAX_TEXT_BYTES {
        return Err(RecordingError::TooLarge { file: file.into(), bytes, limit: MAX_TEXT_BYTES });
    }
    std::fs::read(file).map_err(io)
}

/// The tables of a TOML file's text; `file` is for messages.
pub(crate) fn toml_table(file: &Path, text: &str) -> Result<toml::Table, RecordingError> {
    text.parse()
        .map_err(|e: toml::de::Error| RecordingError::Toml { file: file.into(), reason: e.to_string() })
}

/// Removes a file that may be there.
pub(crate) fn remove(file: &Path) -> Result<(), RecordingError> {
    match std::fs::remove_file(file) {
        Err(source) if source.kind() != std::io::ErrorKind::NotFound => {
            Err(RecordingError::Io { doing: "remove", path: file.into(), source })
        }
        _ => Ok(()),
    }
}

/// Creates a directory for results; refuses a file of that name.
pub(crate) fn create_dir(dir: &Path) -> Result<(), RecordingError> {
    if dir.exists() && !dir.is_dir() {
        return Err(RecordingError::NotADirectory { path: dir.into() });
    }
    std::fs::create_dir_all(dir).map_err(|source| RecordingError::Io {
        doing: "create",
        path: dir.into(),
        source,
    })
}

/// Fills a directory under a temporary name beside `dir`, of which there is nothing yet, and renames it.
pub(crate) fn create_dir_with(
    dir: &Path,
    fill: impl FnOnce(&Path) -> Result<(), RecordingError>,
) -> Result<(), RecordingError> {
    let io = |source| RecordingError::Io { doing: "create", path: dir.into(), source };
    let parent = dir.parent().map_or(Path::new("."), or_here);
    create_dir(parent)?;
    let temporary = tempfile::Builder::new().prefix(".cpcm-").tempdir_in(parent).map_err(io)?;
    fill(temporary.path())?;
    share(temporary.path(), DIRECTORY_MODE).map_err(io)?;
    std::fs::rename(temporary.path(), dir).map_err(io)?;
    // It has another name now, under which it is to stay.
    let _ = temporary.keep();
    Ok(())
}

/// Refuses a directory for results into which nothing can be written, before hours of work go into them. Creates nothing.
pub(crate) fn check_dir(dir: &Path) -> Result<(), RecordingError> {
    let there = dir.ancestors().map(or_here).find(|a| a.exists()).unwrap_or(Path::new("."));
    if !there.is_dir() {
        return Err(RecordingError::NotADirectory { path: there.into() });
    }
    let probe = tempfile::Builder::new().prefix(".cpcm-").tempfile_in(there);
    probe.map(|_| ()).map_err(|source| RecordingError::Io { doing: "write into", path: there.into(), source })
}

/// The same of a file.
pub(crate) fn check_file(file: &Path) -> Result<(), RecordingError> {
    let target = target(file)?;
    let parent = target.parent().map_or(Path::new("."), or_here);
    match parent.exists() {
        true => check_dir(parent),
        false => Err(RecordingError::NoParent { path: parent.into() }),
    }
}

/// The empty path is the present directory.
fn or_here(path: &Path) -> &Path {
    if path.as_os_str().is_empty() { Path::new(".") } else { path }
}

/// Where a file is written: what a link points to. Devices, pipes and directories are not replaced by files.
fn target(file: &Path) -> Result<PathBuf, RecordingError> {
    if file.symlink_metadata().is_err() {
        return Ok(file.into());
    }
    let io = |source| RecordingError::Io { doing: "write", path: file.into(), source };
    let path = file.canonicalize().map_err(io)?;
    match path.is_file() {
        true => Ok(path),
        false => Err(RecordingError::NotAFile { path: file.into() }),
    }
}

/// Longest text of a file that is quoted in a message, characters.
const QUOTED: usize = 40;

/// Text of a file for a message: a damaged file can hold a value of megabytes.
pub(crate) fn quoted(text: &str) -> String {
    match text.char_indices().nth(QUOTED) {
        Some((at, _)) => format!("{}…", &text[..at]),
        None => text.into(),
    }
}

/// Writes a file under a temporary name in the same directory and renames it.
pub(crate) fn write_atomic(file: &Path, bytes: &[u8]) -> Result<(), RecordingError> {
    write_atomic_with(file, |out| out.write_all(bytes))
}

/// Like [`write_atomic`] for a writer that streams.
pub(crate) fn write_atomic_with(
    file: &Path,
    write: impl FnOnce(&mut std::fs::File) -> std::io::Result<()>,
) -> Result<(), RecordingError> {
    let io = |source| RecordingError::Io { doing: "write", path: file.into(), source };
    let target = target(file)?;
    let parent = target.parent().map_or(Path::new("."), or_here);
    let mut temporary = tempfile::Builder::new().prefix(".cpcm-").tempfile_in(parent).map_err(io)?;
    write(temporary.as_file_mut()).map_err(io)?;
    temporary.as_file().sync_all().map_err(io)?;
    share(temporary.path(), FILE_MODE).map_err(io)?;
    temporary.persist(&target).map_err(|e| io(e.error))?;
    Ok(())
}

const FILE_MODE: u32 = 0o644;
const DIRECTORY_MODE: u32 = 0o755;

/// What is temporary is private to its owner; results are for everyone who may read the directory that they are in.
#[cfg(unix)]
fn share(path: &Path, mode: u32) -> std::io::Result<()> {
    use std::os::unix::fs::PermissionsExt;
    std::fs::set_permissions(path, std::fs::Permissions::from_mode(mode))
}

#[cfg(not(unix))]
fn share(_path: &Path, _mode: u32) -> std::io::Result<()> {
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A link was replaced by a file, and so were pipes and devices.
    #[cfg(unix)]
    #[test]
    fn regress_links_are_followed_and_what_is_no_file_is_not_replaced() {
        let dir = tempfile::tempdir().unwrap();
        let (file, link) = (dir.path().join("file"), dir.path().join("link"));
        std::fs::write(&file, "before").unwrap();
        std::os::unix::fs::symlink(&file, &link).unwrap();
        write_atomic(&link, b"after").unwrap();
        assert_eq!(std::fs::read_to_string(&file).unwrap(), "after");
        assert!(link.symlink_metadata().unwrap().file_type().is_symlink());
        assert!(matches!(check_file(dir.path()), Err(RecordingError::NotAFile { .. })));
        check_file(&link).unwrap();
        let nowhere = dir.path().join("new/file");
        assert!(matches!(check_file(&nowhere), Err(RecordingError::NoParent { .. })));
        let device = Path::new("/dev/null");
        assert!(matches!(write_atomic(device, b"x"), Err(RecordingError::NotAFile { .. })));
        assert!(!device.is_file());
    }

    /// A conversion that was interrupted left a part of a site, into which it could not be repeated.
    #[test]
    fn regress_a_directory_appears_when_it_is_complete() {
        let place = tempfile::tempdir().unwrap();
        let dir = place.path().join("new/site");
        let cut = create_dir_with(&dir, |new| {
            std::fs::write(new.join("first"), "half").unwrap();
            Err(RecordingError::NoRows { file: "second".into() })
        });
        assert!(matches!(cut, Err(RecordingError::NoRows { .. })));
        assert_eq!(std::fs::read_dir(dir.parent().unwrap()).unwrap().count(), 0);
        create_dir_with(&dir, |new| write_atomic(&new.join("first"), b"whole")).unwrap();
        assert_eq!(std::fs::read_to_string(dir.join("first")).unwrap(), "whole");
        #[cfg(unix)]
        assert_eq!(
            std::os::unix::fs::PermissionsExt::mode(&dir.metadata().unwrap().permissions()) & 0o777,
            0o755
        );
    }

    #[test]
    fn property_directories_that_cannot_be_written_are_refused_before() {
        let dir = tempfile::tempdir().unwrap();
        check_dir(&dir.path().join("new/results")).unwrap();
        assert!(!dir.path().join("new").exists(), "nothing is created");
        let file = dir.path().join("file");
        std::fs::write(&file, "").unwrap();
        let refused = check_dir(&file.join("results")).unwrap_err();
        assert!(matches!(refused, RecordingError::NotADirectory { .. }), "{refused}");
    }

    #[test]
    fn property_long_texts_are_cut_between_characters() {
        assert_eq!(quoted("short"), "short");
        assert_eq!(quoted(&"µ".repeat(1000)).chars().count(), QUOTED + 1);
    }
}
