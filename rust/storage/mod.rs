//! Durable state: arrays of numbers in a file that survives kills, full disks and bad sectors.
//!
//! `format` is the container (bytes in memory, see `docs/state-format.md`), `file` the way to and from the disk. Neither
//! knows what the numbers mean: a caller checks that after [`load`], and says so with [`Container::refuse`].
//!
//! ```
//! use stochens::{Stop, storage::{self, Section, Tag, Values}};
//! let path = std::env::temp_dir().join(format!("stochens-doc-{}", std::process::id()));
//! let kind = Tag::new("example")?;
//! let sections = [Section { tag: Tag::new("u")?, values: Values::from(&[1.0, -0.0][..]) }];
//! assert_eq!(storage::save(&path, kind, &sections, &Stop::new())?, 1); // the generation
//! let loaded = storage::load(&path, kind, &Stop::new())?;
//! assert!(loaded.recovered.is_none());
//! assert_eq!(loaded.container.reals("u")?, [1.0, 0.0]);
//! # for end in ["", ".lock"] { std::fs::remove_file(format!("{}{end}", path.display())).unwrap() }
//! # Ok::<(), stochens::Error>(())
//! ```

mod disk;
mod fault;
mod file;
mod format;
mod sha256;
#[cfg(test)]
mod tests;

pub use disk::Lock;
pub use fault::Fault;
pub use file::{Loaded, load, lock, save, save_held};
pub use format::{Container, MAX_BYTES, MAX_SECTIONS, Section, Tag, VERSION, Values, decode, encode};
