//! A saved state as named arrays of plain numbers.

use super::estimator::damaged;
use crate::error::Result;
use crate::memory::{try_copy, try_push};

const WHAT: &str = "a state";

/// Prefixes of the arrays of the three entities.
pub(super) const NAMES: [&str; 3] = ["x0", "xf", "A"];

/// Largest dimension: `n^2` entries of a larger one would not fit into any memory.
pub(super) const LARGEST: u64 = 1 << 24;

/// One array of a saved state.
#[derive(Debug, Clone, PartialEq)]
pub enum SavedArray {
    /// Bytes.
    U8(Vec<u8>),
    /// Counters.
    U64(Vec<u64>),
    /// Numbers; all finite unless said otherwise.
    F64(Vec<f64>),
}

/// Named arrays, in a fixed order.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Sections(pub Vec<(String, SavedArray)>);

impl Sections {
    pub(super) fn put_u64(&mut self, name: impl Into<String>, values: &[u64]) -> Result<()> {
        let section = SavedArray::U64(try_copy(WHAT, values)?);
        try_push(WHAT, &mut self.0, (name.into(), section))
    }

    pub(super) fn put_f64(&mut self, name: impl Into<String>, values: &[f64]) -> Result<()> {
        let section = SavedArray::F64(try_copy(WHAT, values)?);
        try_push(WHAT, &mut self.0, (name.into(), section))
    }

    pub(super) fn put_u8(&mut self, name: impl Into<String>, values: &[u8]) -> Result<()> {
        let section = SavedArray::U8(try_copy(WHAT, values)?);
        try_push(WHAT, &mut self.0, (name.into(), section))
    }

    fn take(&mut self, name: &str) -> Result<SavedArray> {
        let at = self.0.iter().position(|(known, _)| known == name);
        let at = at.ok_or_else(|| damaged("complete", format!("no section {name:?}")))?;
        Ok(self.0.remove(at).1)
    }

    pub(super) fn take_u64(&mut self, name: &str, len: Option<usize>) -> Result<Vec<u64>> {
        match self.take(name)? {
            SavedArray::U64(values) if len.is_none_or(|len| len == values.len()) => Ok(values),
            other => Err(misfit(name, "counters", len, &other)),
        }
    }

    /// Numbers, all of them finite.
    pub(super) fn take_f64(&mut self, name: &str, len: Option<usize>) -> Result<Vec<f64>> {
        match self.take(name)? {
            SavedArray::F64(values) if len.is_none_or(|len| len == values.len()) => {
                match values.iter().position(|v| !v.is_finite()) {
                    None => Ok(values),
                    Some(at) => {
                        Err(damaged("a state of finite numbers", format!("{} at index {at} of {name:?}", values[at])))
                    }
                }
            }
            other => Err(misfit(name, "numbers", len, &other)),
        }
    }

    pub(super) fn take_u8(&mut self, name: &str, len: usize) -> Result<Vec<u8>> {
        match self.take(name)? {
            SavedArray::U8(values) if len == values.len() => Ok(values),
            other => Err(misfit(name, "bytes", Some(len), &other)),
        }
    }

    /// Refuses sections that have not been taken.
    pub(super) fn finish(self) -> Result<()> {
        match self.0.first() {
            None => Ok(()),
            Some((name, _)) => Err(damaged("a state without unknown sections", format!("{name:?}"))),
        }
    }
}

fn misfit(name: &str, kind: &str, len: Option<usize>, found: &SavedArray) -> crate::Error {
    let (is, has) = match found {
        SavedArray::U8(values) => ("bytes", values.len()),
        SavedArray::U64(values) => ("counters", values.len()),
        SavedArray::F64(values) => ("numbers", values.len()),
    };
    let wanted = len.map_or(String::new(), |len| format!("{len} "));
    damaged("a state with arrays of the right sizes", format!("{has} {is} for {wanted}{kind} in {name:?}"))
}
