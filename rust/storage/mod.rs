//! Durable state: arrays of numbers in a file that survives crashes of the writer, full disks and bad sectors.
//!
//! `format` is the container in memory (see `docs/systems.md`), `file` writes and reads it. Neither knows what the
//! numbers mean: the caller checks that after [`load`]. Types
//! that know it are [`Saved`].
//!
//! ```
//! use stochens::{Stop, storage::{self, Section, Values}};
//! let path = std::env::temp_dir().join(format!("stochens-doc-{}", std::process::id()));
//! let sections = [Section { name: "u".into(), values: Values::Reals(vec![1.0, -0.0].into()) }];
//! assert_eq!(storage::save(&path, "example", &sections, &Stop::new())?, 1); // the generation
//! let loaded = storage::load(&path, "example", &Stop::new())?;
//! assert!(loaded.recovered.is_none());
//! assert_eq!(loaded.container.sections, sections);
//! # for end in ["", ".lock"] { std::fs::remove_file(format!("{}{end}", path.display())).unwrap() }
//! # Ok::<(), stochens::Error>(())
//! ```

mod disk;
mod file;
mod format;
mod saved;
mod sections;
#[cfg(test)]
mod tests;

pub use crate::fault::{Fault, MAX_BYTES, VERSION};
pub use disk::Lock;
pub use file::{Loaded, load, lock, save, save_held};
pub use format::{Container, MAX_HEADER, Section, Values, decode, encode};
pub use saved::Saved;
pub use sections::Sections;
pub(crate) use sections::{LARGEST, damaged};
