//! Operations on the disk, each with the name used in its error message.
//!
//! In unit tests, each operation that writes can fail, or be the last before a crash: see `tests/file.rs`.

use std::fs::{self, File, Metadata, OpenOptions, TryLockError};
use std::io::{self, ErrorKind, Read, Write};
use std::path::Path;

use super::format::{WHAT, refusal};
#[cfg(test)]
use super::tests::disk_point as point;
use crate::error::{Error, Result};
use crate::fault::{Fault, MAX_BYTES};
use crate::memory::try_room;
use crate::parallel::Stop;

/// Bytes between two checks of the stop flag.
const BLOCK: usize = 1 << 20;

#[cfg(not(test))]
fn point(_action: &str) -> io::Result<()> {
    Ok(())
}

pub(super) fn os(action: &'static str, path: &Path) -> impl Fn(io::Error) -> Error {
    move |error| {
        let reason = error.to_string();
        // the error has a field for the number
        let reason = reason.split(" (os error").next().unwrap_or_default().to_lowercase();
        Error::Os { action, path: path.into(), code: error.raw_os_error(), reason }
    }
}

/// The metadata of `path`, of a symbolic link itself; `None` if nothing is there.
pub(super) fn look(path: &Path) -> Result<Option<Metadata>> {
    match fs::symlink_metadata(path) {
        Ok(metadata) => Ok(Some(metadata)),
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
        Err(error) => Err(os("access", path)(error)),
    }
}

/// Refuses all but regular files: opening a pipe or a device could block or have side effects.
pub(super) fn require_regular(path: &Path, metadata: &Metadata) -> Result<()> {
    let kind = metadata.file_type();
    let what = match kind {
        _ if kind.is_file() => return Ok(()),
        _ if kind.is_dir() => "a directory",
        _ if kind.is_symlink() => "a symbolic link",
        _ => "a pipe, a socket or a device",
    };
    Err(refusal(path, Fault::NotRegular { what }))
}

/// The whole file, through symbolic links. The action in errors is `open` until something has been read, then `read`.
pub(super) fn read(path: &Path, stop: &Stop) -> Result<Vec<u8>> {
    require_regular(path, &fs::metadata(path).map_err(os("open", path))?)?;
    let file = File::open(path).map_err(os("open", path))?;
    let metadata = file.metadata().map_err(os("open", path))?;
    require_regular(path, &metadata)?; // another file may have replaced it since the first check
    let found = metadata.len();
    if found > MAX_BYTES {
        return Err(refusal(path, Fault::TooLarge { found }));
    }
    let mut bytes = try_room(WHAT, found as usize)?;
    loop {
        stop.check()?;
        // the file may shrink or grow meanwhile: at most its first length is read
        let block = (found - bytes.len() as u64).min(BLOCK as u64);
        if (&file).take(block).read_to_end(&mut bytes).map_err(os("read", path))? == 0 {
            return Ok(bytes);
        }
    }
}

/// A lock that ends only with this object or with its process.
///
/// A forked child shares the open file. It cannot end the lock; but if the process is killed, the lock lasts until the
/// child has closed its copy as well.
#[derive(Debug)]
pub struct Lock {
    file: File,
    process: u32,
}

impl Lock {
    /// Takes the lock, or returns [`Error::Locked`] at once; `path` is the file it protects, `lock` an empty file.
    ///
    /// The lock file is never removed: a writer that waits for a removed file would lock a file that no other writer
    /// sees.
    pub(super) fn take(lock: &Path, path: &Path) -> Result<Self> {
        if let Some(metadata) = look(lock)? {
            require_regular(lock, &metadata)?;
        }
        point("open").map_err(os("open", lock))?;
        let file = OpenOptions::new().write(true).create(true).truncate(false).open(lock).map_err(os("open", lock))?;
        match file.try_lock() {
            Ok(()) => Ok(Self { file, process: std::process::id() }),
            Err(TryLockError::WouldBlock) => Err(Error::Locked { path: path.into() }),
            Err(TryLockError::Error(error)) => Err(os("lock", lock)(error)),
        }
    }
}

impl Drop for Lock {
    fn drop(&mut self) {
        // Closing is not enough, since a forked child shares the open file. If unlocking fails, the lock lasts until
        // that child ends, and the next writer gets an error. The child itself must not unlock it for its parent.
        if self.process == std::process::id() {
            let _ = self.file.unlock();
        }
    }
}

/// Writes a new file and syncs it; `like` gives the permissions of the file it replaces.
pub(super) fn write_new(path: &Path, bytes: &[u8], like: Option<&Metadata>, stop: &Stop) -> Result<()> {
    point("create").map_err(os("create", path))?;
    // `create_new` follows no symbolic link and opens no existing file
    let mut file = OpenOptions::new().write(true).create_new(true).open(path).map_err(os("create", path))?;
    if let Some(metadata) = like {
        file.set_permissions(metadata.permissions()).map_err(os("set the permissions of", path))?;
    }
    write_synced(&mut file, path, bytes, stop)
}

pub(super) fn write_synced(file: &mut File, path: &Path, bytes: &[u8], stop: &Stop) -> Result<()> {
    for block in bytes.chunks(BLOCK) {
        stop.check()?;
        if let Err(error) = point("write") {
            let _ = file.write(&block[..block.len() / 2]); // a failing disk may have written a part
            return Err(os("write", path)(error));
        }
        file.write_all(block).map_err(os("write", path))?;
    }
    stop.check()?;
    // Not tried again after an error: a second sync could succeed without the lost pages.
    point("sync").and_then(|()| file.sync_all()).map_err(os("sync", path))
}

/// Makes a hard link; `false` if the file system has none, or allows no more for this file.
pub(super) fn hard_link(from: &Path, to: &Path) -> Result<bool> {
    match point("link").and_then(|()| fs::hard_link(from, to)) {
        Ok(()) => Ok(true),
        // Linux returns EPERM on file systems without links
        Err(error)
            if matches!(
                error.kind(),
                ErrorKind::PermissionDenied | ErrorKind::Unsupported | ErrorKind::TooManyLinks
            ) =>
        {
            Ok(false)
        }
        Err(error) => Err(os("link", from)(error)),
    }
}

pub(super) fn rename(from: &Path, to: &Path) -> Result<()> {
    point("rename").and_then(|()| fs::rename(from, to)).map_err(os("rename", from))
}

/// Removes a file if possible; the next save removes the rest.
pub(super) fn remove(path: &Path) {
    let _ = point("remove").and_then(|()| fs::remove_file(path));
}

/// Makes the names in a directory durable, if the system can.
pub(super) fn sync_directory(path: &Path) -> Result<()> {
    if cfg!(not(unix)) {
        return Ok(()); // Windows cannot open a directory; NTFS has a journal of names
    }
    match point("sync the directory").and_then(|()| File::open(path)).and_then(|directory| directory.sync_all()) {
        // some network file systems have no such operation and do not need it
        Err(error) if matches!(error.kind(), ErrorKind::InvalidInput | ErrorKind::Unsupported) => Ok(()),
        result => result.map_err(os("sync the directory", path)),
    }
}
