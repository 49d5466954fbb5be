//! Saving and loading: at any time, also after a crash of the writer, one complete generation can be loaded.
//!
//! Beside `state` there are `state.prev`, the generation before it; `state.lock`, empty, locked by a writer; and,
//! during a save, `state.<16 hexadecimal digits>.tmp`. The table shows the steps of a save. "g" is the generation
//! before the save, "h" an older one or none. A generation is complete and synced before it gets its final name.
//!
//! | after a crash behind step                  | `state` | `state.prev` | left over | loaded |
//! |--------------------------------------------|---------|--------------|-----------|--------|
//! | 1. lock, remove what dead writers left     | g       | h            |           | g      |
//! | 2. write g+1 to a temporary, sync it       | g       | h            | g+1       | g      |
//! | 3. link `state` to a second temporary      | g       | h            | g+1, g    | g      |
//! | 4. rename that over `state.prev`           | g       | g            | g+1       | g      |
//! | 5. rename the first over `state`           | g+1     | g            |           | g+1    |
//! | 6. sync the directory                      | g+1     | g            |           | g+1    |
//!
//! Without hard links, 3 and 4 are one rename of `state` to `state.prev`: then only `state.prev` exists before step 5,
//! and g is loaded from there. A power failure may undo or reorder 3 to 5 until 6 has returned. As no name ever points
//! to a file that is not synced, each of the two names still points to a complete generation: h, g or g+1, and `state`
//! to g or g+1. A save is reported as done only after 6. If `state` is damaged, 3 and 4 are skipped, so that the last
//! good generation is not replaced by a bad one.

use std::ffi::OsString;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::SystemTime;

use super::disk::{self, Lock};
use super::format::{Container, Section, check_names, decode, encode};
use crate::error::{Error, Result};
use crate::fault::Fault;
use crate::parallel::Stop;

/// A loaded state.
#[derive(Debug, Clone, PartialEq)]
pub struct Loaded {
    /// Its contents.
    pub container: Container,
    /// Why the previous generation was loaded; `None` if the file itself is good.
    pub recovered: Option<Error>,
}

/// Saves a state as the next generation of the file at `path`, and returns the generation's number.
///
/// When this returns, the state is on the disk; until then, and after any error or crash, the generation before can be
/// loaded. The existing file is read and checked first, because only a good one may become the previous generation.
/// Errors: [`Error::Locked`] if another writer has the lock, [`Error::State`] if the file at `path` is not a state of
/// this kind (it is not overwritten), [`Error::Os`] if an operation fails, [`Error::Interrupted`].
pub fn save(path: &Path, kind: &str, sections: &[Section<'_>], stop: &Stop) -> Result<u64> {
    check_names(kind, sections)?; // before any file is made
    save_held(&lock(path)?, path, kind, sections, stop)
}

/// The writer's lock on `path`, for several saves; [`Error::Locked`] if another writer has it.
pub fn lock(path: &Path) -> Result<Lock> {
    let place = Place::new(path)?;
    if let Some(metadata) = disk::look(path)? {
        disk::require_regular(path, &metadata)?;
    }
    Lock::take(&place.beside(".lock"), path) // 1
}

/// [`save`] for the owner of the lock on `path`.
pub fn save_held(_held: &Lock, path: &Path, kind: &str, sections: &[Section<'_>], stop: &Stop) -> Result<u64> {
    let place = Place::new(path)?;
    let old = disk::look(path)?;
    if let Some(metadata) = &old {
        disk::require_regular(path, metadata)?;
    }
    place.sweep();
    let survey = survey(&place, kind, stop)?;
    let next = survey
        .generation
        .checked_add(1)
        .ok_or_else(|| super::format::refusal(path, Fault::Content("no larger generation number".into())))?;
    let bytes = encode(kind, next, sections, stop)?;
    let new = Temporary(place.temporary());
    disk::write_new(&new.0, &bytes, old.as_ref(), stop)?; // 2
    if survey.keep {
        place.keep()?; // 3 and 4
    }
    disk::rename(&new.0, path)?; // 5
    disk::sync_directory(&place.directory)?; // 6
    Ok(next)
}

/// Loads the state of this `kind` that was saved at `path`; writes nothing.
///
/// If the file is missing or damaged, the previous generation is loaded and the result says why. Errors:
/// [`Error::State`] if neither can be used, [`Error::Os`] if an operation fails (also if there is no file),
/// [`Error::Interrupted`].
pub fn load(path: &Path, kind: &str, stop: &Stop) -> Result<Loaded> {
    let why = match read(path, kind, stop) {
        Ok(container) => return Ok(Loaded { container, recovered: None }),
        Err(error) if is_lost(&error) => error,
        Err(error) => return Err(error),
    };
    // a path that `save` refuses, such as that of a previous generation, has no previous generation
    let Ok(place) = Place::new(path) else { return Err(why) };
    match read(&place.previous(), kind, stop) {
        Ok(container) => Ok(Loaded { container, recovered: Some(why) }),
        Err(Error::Interrupted) => Err(Error::Interrupted),
        Err(other) => Err(match (why, is_missing(&other)) {
            // nothing at `path`, and a previous generation that cannot be used: report the latter
            (why, false) if is_missing(&why) => other,
            (Error::State { path, fault, .. }, _) => {
                Error::State { path, fault, previous: Some(format!("there is no previous generation: {other}")) }
            }
            (why, _) => why,
        }),
    }
}

/// The container in a file.
pub(super) fn read(path: &Path, kind: &str, stop: &Stop) -> Result<Container> {
    decode(path, &disk::read(path, stop)?, kind, stop)
}

fn is_missing(error: &Error) -> bool {
    matches!(error, Error::Os { code: Some(code), .. }
        if std::io::Error::from_raw_os_error(*code).kind() == ErrorKind::NotFound)
}

/// Whether the previous generation may be loaded instead: the file is missing, damaged, or on a bad sector.
fn is_lost(error: &Error) -> bool {
    match error {
        Error::State { fault, .. } => fault.is_damage(),
        Error::Os { action, .. } => *action == "read" || is_missing(error),
        _ => false,
    }
}

/// The files before a save.
struct Survey {
    /// The newest good generation, 0 if there is none.
    generation: u64,
    /// Whether the file at the path is good and must become the previous generation.
    keep: bool,
}

/// Checks what a save would replace; refuses all but a state of this kind, good or damaged.
fn survey(place: &Place, kind: &str, stop: &Stop) -> Result<Survey> {
    let why = match read(&place.path, kind, stop) {
        Ok(container) => return Ok(Survey { generation: container.generation, keep: true }),
        Err(error) if is_lost(&error) => error,
        Err(error) => return Err(error),
    };
    match read(&place.previous(), kind, stop) {
        Ok(container) => Ok(Survey { generation: container.generation, keep: false }),
        // not a state, and no previous generation that shows that there was one
        Err(other) if is_lost(&other) => match why {
            Error::State { fault: Fault::Foreign, .. } => Err(why),
            _ => Ok(Survey { generation: 0, keep: false }),
        },
        Err(other) => Err(other),
    }
}

/// The names around a state file.
struct Place {
    path: PathBuf,
    directory: PathBuf,
    name: OsString,
}

impl Place {
    fn new(path: &Path) -> Result<Self> {
        let wrong = |expected| Error::Value { name: "path", expected, found: format!("{path:?}") };
        let name = path.file_name().ok_or_else(|| wrong("the path of a file"))?.to_owned();
        if path.extension().is_some_and(|end| end == "prev" || end == "lock" || end == "tmp") {
            return Err(wrong("a name that does not end in .prev, .lock or .tmp, which are reserved"));
        }
        let parent = path.parent().unwrap_or(Path::new(""));
        let directory = if parent.as_os_str().is_empty() { Path::new(".") } else { parent };
        Ok(Self { path: path.into(), directory: directory.into(), name })
    }

    fn beside(&self, end: &str) -> PathBuf {
        let mut name = self.name.clone();
        name.push(end);
        self.path.with_file_name(name)
    }

    fn previous(&self) -> PathBuf {
        self.beside(".prev")
    }

    /// A name that no other writer uses, not even on another machine, where the lock may have no effect.
    fn temporary(&self) -> PathBuf {
        static SERIAL: AtomicU32 = AtomicU32::new(0);
        let now = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
        let serial = u64::from(SERIAL.fetch_add(1, Ordering::Relaxed)) << 32;
        // an odd multiplier spreads the nanoseconds over all 64 bits, apart from those of the process number
        let spread = (now.as_nanos() as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        let digits = spread ^ serial ^ u64::from(std::process::id());
        self.beside(&format!(".{digits:016x}.tmp"))
    }

    /// Removes the temporary files of this state. Their writers are dead, since this process holds the lock.
    fn sweep(&self) {
        let Ok(entries) = std::fs::read_dir(&self.directory) else { return };
        let mut start = self.name.clone();
        start.push(".");
        let start = start.as_encoded_bytes();
        for entry in entries.flatten() {
            let name = entry.file_name();
            let middle = name.as_encoded_bytes().strip_prefix(start).and_then(|rest| rest.strip_suffix(b".tmp"));
            if middle.is_some_and(|digits| digits.len() == 16 && digits.iter().all(u8::is_ascii_hexdigit)) {
                disk::remove(&entry.path());
            }
        }
    }

    /// Makes the good file at `path` the previous generation.
    fn keep(&self) -> Result<()> {
        let second = Temporary(self.temporary());
        let linked = disk::hard_link(&self.path, &second.0)?;
        // A rename does nothing if both names already point to the same file, as after a crash behind step 4; then
        // `second` is removed when it is dropped.
        disk::rename(if linked { &second.0 } else { &self.path }, &self.previous())
    }
}

/// A file that is removed when this is dropped, unless it has been renamed.
struct Temporary(PathBuf);

impl Drop for Temporary {
    fn drop(&mut self) {
        disk::remove(&self.0);
    }
}
