//! What knows how to be a file.

use std::path::Path;

use super::file::{read, save};
use super::format::refusal;
use super::sections::Sections;
use crate::error::{Error, Result};
use crate::fault::Fault;
use crate::parallel::Stop;

/// What is saved in a file, and judged as any other input when it is loaded: a file is not trusted.
///
/// Of a type of your own, give the first three:
///
/// ```
/// use stochens::storage::{Saved, Sections};
/// use stochens::{Result, Stop};
///
/// #[derive(Debug, PartialEq)]
/// struct Weight(f64);
///
/// impl Saved for Weight {
///     const KIND: &'static str = "weight";
///
///     fn put(&self, to: &mut Sections) -> Result<()> {
///         to.put_f64("weight", &[self.0])
///     }
///
///     fn take(from: &mut Sections, _: &Stop) -> Result<Self> {
///         Ok(Self(from.take_f64("weight", Some(1))?[0]))
///     }
/// }
///
/// let path = std::env::temp_dir().join(format!("weight-{}", std::process::id()));
/// assert_eq!(Weight(0.1).save(&path, &Stop::new())?, 1); // the generation
/// assert_eq!(Weight::load(&path, &Stop::new())?, Weight(0.1));
/// # for end in ["", ".lock"] { std::fs::remove_file(format!("{}{end}", path.display())).unwrap() }
/// # Ok::<(), stochens::Error>(())
/// ```
pub trait Saved: Sized {
    /// The kind of the files: 1 to 64 letters, digits, `_`, `-` or `.`.
    const KIND: &'static str;

    /// Puts all that is needed to make it again.
    ///
    /// # Errors
    /// [`Error::Memory`].
    fn put(&self, to: &mut Sections) -> Result<()>;

    /// Takes what [`Self::put`] has put, checks it, and makes it again.
    ///
    /// # Errors
    /// Any but [`Error::State`], for sections that cannot have been put.
    fn take(from: &mut Sections, stop: &Stop) -> Result<Self>;

    /// Saves it as the next generation of the file at `path`, whose number is returned; the one before stays at
    /// `path.prev`.
    ///
    /// # Errors
    /// Those of [`super::save`].
    fn save(&self, path: impl AsRef<Path>, stop: &Stop) -> Result<u64> {
        let mut sections = Sections::default();
        self.put(&mut sections)?;
        save(path.as_ref(), Self::KIND, &sections.0, stop)
    }

    /// Loads it, with the same bits on the same kind of processor. Only this file is read: `path.prev` has a name of
    /// its own.
    ///
    /// # Errors
    /// [`Error::State`] if the file is damaged, of another kind or version, or holds what cannot be; [`Error::Os`],
    /// [`Error::Memory`], [`Error::Interrupted`].
    fn load(path: impl AsRef<Path>, stop: &Stop) -> Result<Self> {
        let path = path.as_ref();
        let mut sections = Sections(read(path, Self::KIND, stop)?.sections);
        let made = Self::take(&mut sections, stop).and_then(|made| sections.finish().map(|()| made));
        made.map_err(|error| match error {
            Error::Interrupted | Error::Memory { .. } => error,
            other => refusal(path, Fault::Content(other.to_string())),
        })
    }
}
