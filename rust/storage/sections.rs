//! Named arrays for a file: put one after the other, and taken out again by name, type and size.

use super::format::{Section, Values, WHAT};
use crate::error::{Error, Result};
use crate::memory::{try_copy, try_push};

/// Largest number of states, inputs or parts: `n^2` entries of a larger one would not fit into any memory.
pub(crate) const LARGEST: u64 = 1 << 24;

/// Named arrays, in a fixed order.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Sections(pub Vec<Section<'static>>);

/// The error of a state that cannot have been saved.
pub(crate) fn damaged(expected: &'static str, found: String) -> Error {
    Error::Value { name: "state", expected, found }
}

impl Sections {
    fn put(&mut self, name: impl Into<String>, values: Values<'static>) -> Result<()> {
        try_push(WHAT, &mut self.0, Section { name: name.into().into(), values })
    }

    /// Appends counters.
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub fn put_u64(&mut self, name: impl Into<String>, values: &[u64]) -> Result<()> {
        self.put(name, Values::Integers(try_copy(WHAT, values)?.into()))
    }

    /// Appends numbers.
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub fn put_f64(&mut self, name: impl Into<String>, values: &[f64]) -> Result<()> {
        self.put(name, Values::Reals(try_copy(WHAT, values)?.into()))
    }

    /// Appends bytes.
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub fn put_u8(&mut self, name: impl Into<String>, values: &[u8]) -> Result<()> {
        self.put(name, Values::Bytes(try_copy(WHAT, values)?.into()))
    }

    fn take(&mut self, name: &str) -> Result<Values<'static>> {
        let at = self.0.iter().position(|section| section.name == name);
        let at = at.ok_or_else(|| damaged("complete", format!("no section {name:?}")))?;
        Ok(self.0.remove(at).values)
    }

    /// Takes counters out, of this number if there is one.
    ///
    /// # Errors
    /// [`Error::Value`] if there are none of this name, or others.
    pub fn take_u64(&mut self, name: &str, len: Option<usize>) -> Result<Vec<u64>> {
        match self.take(name)? {
            Values::Integers(values) if len.is_none_or(|len| len == values.len()) => Ok(values.into_owned()),
            other => Err(misfit(name, "counters", len, &other)),
        }
    }

    /// Takes sizes out that stand behind the number of their format, each at most `1 << 24`.
    ///
    /// # Errors
    /// As [`Self::take_u64`].
    pub fn take_sizes<const N: usize>(&mut self, name: &str, format: u64) -> Result<[usize; N]> {
        let found = self.take_u64(name, Some(N + 1))?;
        if found[0] != format || found[1..].iter().any(|size| *size > LARGEST) {
            return Err(damaged("of a format and a size that this release reads", format!("{found:?} in {name:?}")));
        }
        Ok(std::array::from_fn(|at| found[at + 1] as usize))
    }

    /// Takes numbers out, all of them finite.
    ///
    /// # Errors
    /// As [`Self::take_u64`].
    pub fn take_f64(&mut self, name: &str, len: Option<usize>) -> Result<Vec<f64>> {
        let values = self.take_reals(name, len)?;
        match values.iter().position(|v| !v.is_finite()) {
            None => Ok(values),
            Some(at) => Err(damaged("a state of finite numbers", format!("{} at index {at} of {name:?}", values[at]))),
        }
    }

    /// Takes numbers out, whatever they are.
    ///
    /// # Errors
    /// As [`Self::take_u64`].
    pub fn take_reals(&mut self, name: &str, len: Option<usize>) -> Result<Vec<f64>> {
        match self.take(name)? {
            Values::Reals(values) if len.is_none_or(|len| len == values.len()) => Ok(values.into_owned()),
            other => Err(misfit(name, "numbers", len, &other)),
        }
    }

    /// Takes bytes out.
    ///
    /// # Errors
    /// As [`Self::take_u64`].
    pub fn take_u8(&mut self, name: &str, len: usize) -> Result<Vec<u8>> {
        match self.take(name)? {
            Values::Bytes(values) if len == values.len() => Ok(values.into_owned()),
            other => Err(misfit(name, "bytes", Some(len), &other)),
        }
    }

    /// Refuses sections that have not been taken.
    ///
    /// # Errors
    /// [`Error::Value`] if there is one.
    pub fn finish(self) -> Result<()> {
        match self.0.first() {
            None => Ok(()),
            Some(section) => Err(damaged("a state without unknown sections", format!("{:?}", section.name))),
        }
    }
}

fn misfit(name: &str, kind: &str, len: Option<usize>, found: &Values<'_>) -> Error {
    let (is, has) = match found {
        Values::Bytes(values) => ("bytes", values.len()),
        Values::Integers(values) => ("counters", values.len()),
        Values::Reals(values) => ("numbers", values.len()),
    };
    let wanted = len.map_or(String::new(), |len| format!("{len} "));
    damaged("a state with arrays of the right sizes", format!("{has} {is} for {wanted}{kind} in {name:?}"))
}
