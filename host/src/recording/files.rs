//! Small files: reading with a size limit, writing so that a reader never sees half a file.

use std::io::Write;
use std::path::Path;

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
    let parent = file.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let mut temporary = tempfile::Builder::new().prefix(".cpcm-").tempfile_in(parent).map_err(io)?;
    write(temporary.as_file_mut()).map_err(io)?;
    temporary.as_file().sync_all().map_err(io)?;
    share(temporary.as_file()).map_err(io)?;
    temporary.persist(file).map_err(|e| io(e.error))?;
    Ok(())
}

/// Temporary files are private to their owner; results are for everyone who may read the directory.
#[cfg(unix)]
fn share(file: &std::fs::File) -> std::io::Result<()> {
    use std::os::unix::fs::PermissionsExt;
    file.set_permissions(std::fs::Permissions::from_mode(0o644))
}

#[cfg(not(unix))]
fn share(_file: &std::fs::File) -> std::io::Result<()> {
    Ok(())
}
