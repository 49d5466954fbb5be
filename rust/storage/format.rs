//! The container of a state: named arrays of bytes, integers and reals, sealed with a checksum.
//!
//! Everything is little-endian, everything begins at a multiple of 8, and the same contents always give the same bytes
//! (all of it exact in `docs/state-format.md`):
//!
//! ```text
//! 0   magic, 8 bytes             16  version, u32         24  kind, 8 bytes
//! 8   length of the file, u64    20  sections, u32        32  generation, u64
//! 40  table, 24 bytes a section: name (8 bytes), element type u32, zero u32, number of elements u64
//!     the arrays in the order of the table, each padded with zeros to a multiple of 8
//! end SHA-256 of all that precedes, 32 bytes
//! ```
//!
//! There are no offsets in the file, so no two sections can overlap. Magic, length and checksum keep their places in all
//! versions: damage can be told from a file of the future.

use std::borrow::Cow;
use std::path::{Path, PathBuf};

use super::fault::Fault;
use super::sha256::sha256;
use crate::error::{Error, Result};
use crate::memory::{try_collect, try_room};
use crate::parallel::Stop;

/// What messages say that memory is for.
pub(super) const WHAT: &str = "a state";

/// The format's version that is written, and the only one that is read.
pub const VERSION: u32 = 1;

/// No file is longer than this; less where addresses are short.
pub const MAX_BYTES: u64 = if usize::BITS < 64 { 1 << 30 } else { 1 << 34 };

/// No file has more sections than this.
pub const MAX_SECTIONS: u32 = 4096;

// A byte above 127 and both kinds of line ends: whoever treats the file as text breaks it visibly.
const MAGIC: [u8; 8] = *b"\x89STO\r\n\x1a\n";
const HEADER: usize = 40;
const ENTRY: usize = 24;
const DIGEST: usize = 32;
pub(super) const SMALLEST: usize = HEADER + DIGEST;

/// A name of 1 to 8 letters, digits, `_`, `-` or `.`, in the file padded with spaces.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Tag([u8; 8]);

impl Tag {
    /// The tag called `name`.
    pub fn new(name: &str) -> Result<Self> {
        let mut bytes = [b' '; 8];
        let fits = name.len() <= bytes.len();
        bytes.iter_mut().zip(name.bytes()).for_each(|(to, from)| *to = from);
        Self::read(bytes).filter(|tag| fits && tag.to_string() == name).ok_or_else(|| Error::Value {
            name: "tag",
            expected: "1 to 8 letters, digits, '_', '-' or '.'",
            found: format!("{:.40}", format!("{name:?}")),
        })
    }

    fn read(bytes: [u8; 8]) -> Option<Self> {
        let end = bytes.iter().rposition(|&byte| byte != b' ')? + 1;
        let good = |byte: &u8| byte.is_ascii_alphanumeric() || b"_-.".contains(byte);
        bytes[..end].iter().all(good).then_some(Self(bytes))
    }
}

impl std::fmt::Display for Tag {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.0.escape_ascii().to_string().trim_end_matches(' '))
    }
}

impl std::fmt::Debug for Tag {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Tag({self})")
    }
}

/// The elements of a section.
#[derive(Debug, Clone, PartialEq)]
pub enum Values<'a> {
    /// Unsigned 8-bit integers, element type 1.
    Bytes(Cow<'a, [u8]>),
    /// Unsigned 64-bit integers, element type 2.
    Integers(Cow<'a, [u64]>),
    /// Doubles, bit for bit, element type 3.
    Reals(Cow<'a, [f64]>),
}

impl<'a> From<&'a [u8]> for Values<'a> {
    fn from(values: &'a [u8]) -> Self {
        Self::Bytes(values.into())
    }
}

impl<'a> From<&'a [u64]> for Values<'a> {
    fn from(values: &'a [u64]) -> Self {
        Self::Integers(values.into())
    }
}

impl<'a> From<&'a [f64]> for Values<'a> {
    fn from(values: &'a [f64]) -> Self {
        Self::Reals(values.into())
    }
}

impl Values<'_> {
    fn code(&self) -> u32 {
        match self {
            Self::Bytes(_) => 1,
            Self::Integers(_) => 2,
            Self::Reals(_) => 3,
        }
    }

    fn len(&self) -> usize {
        match self {
            Self::Bytes(values) => values.len(),
            Self::Integers(values) => values.len(),
            Self::Reals(values) => values.len(),
        }
    }

    fn write(&self, out: &mut Vec<u8>) {
        match self {
            Self::Bytes(values) => out.extend_from_slice(values),
            Self::Integers(values) => values.iter().for_each(|value| out.extend_from_slice(&value.to_le_bytes())),
            Self::Reals(values) => values.iter().for_each(|value| out.extend_from_slice(&value.to_le_bytes())),
        }
        out.resize(out.len().next_multiple_of(8), 0);
    }
}

/// A named array.
#[derive(Debug, Clone, PartialEq)]
pub struct Section<'a> {
    /// Its name, unique in the file.
    pub tag: Tag,
    /// Its elements.
    pub values: Values<'a>,
}

/// What a state file contains.
#[derive(Debug, Clone, PartialEq)]
pub struct Container {
    /// Which file it was, for messages.
    pub source: PathBuf,
    /// What the state is of.
    pub kind: Tag,
    /// 1 for the first state saved under a path, then one more each time.
    pub generation: u64,
    /// The arrays, in the order in which they were saved.
    pub sections: Vec<Section<'static>>,
}

impl Container {
    /// The bytes called `name`.
    pub fn bytes(&self, name: &str) -> Result<&[u8]> {
        match self.values(name) {
            Some(Values::Bytes(values)) => Ok(values),
            _ => Err(self.missing(name, "bytes")),
        }
    }

    /// The integers called `name`.
    pub fn integers(&self, name: &str) -> Result<&[u64]> {
        match self.values(name) {
            Some(Values::Integers(values)) => Ok(values),
            _ => Err(self.missing(name, "64-bit integers")),
        }
    }

    /// The doubles called `name`.
    pub fn reals(&self, name: &str) -> Result<&[f64]> {
        match self.values(name) {
            Some(Values::Reals(values)) => Ok(values),
            _ => Err(self.missing(name, "doubles")),
        }
    }

    /// The error of a reader to whom the well-sealed contents make no sense.
    pub fn refuse(&self, why: impl Into<String>) -> Error {
        refusal(&self.source, Fault::Content(why.into()))
    }

    fn values(&self, name: &str) -> Option<&Values<'static>> {
        self.sections.iter().find(|section| section.tag.to_string() == name).map(|section| &section.values)
    }

    fn missing(&self, name: &str, expected: &'static str) -> Error {
        refusal(&self.source, Fault::Missing { tag: name.into(), expected })
    }
}

pub(super) fn refusal(source: &Path, fault: Fault) -> Error {
    Error::State { path: source.into(), fault, previous: None }
}

/// The bytes of a file with these contents.
pub fn encode(kind: Tag, generation: u64, sections: &[Section<'_>], stop: &Stop) -> Result<Vec<u8>> {
    let mut tags = try_collect(WHAT, sections.iter().map(|section| section.tag))?;
    tags.sort_unstable();
    if let Some(pair) = tags.windows(2).find(|pair| pair[0] == pair[1]) {
        let found = format!("'{}' twice", pair[0]);
        return Err(Error::Value { name: "sections", expected: "of different names", found });
    }
    if sections.len() > MAX_SECTIONS as usize {
        let found = sections.len().to_string();
        return Err(Error::Value { name: "sections", expected: "at most 4096", found });
    }
    let sizes = sections.iter().map(|section| padded(section.values.code(), section.values.len() as u64));
    let length = sizes.map(|size| size.unwrap_or(u64::MAX)).fold(0, u64::saturating_add);
    let length = length.saturating_add((SMALLEST + ENTRY * sections.len()) as u64);
    if length > MAX_BYTES {
        let found = format!("{length} bytes");
        return Err(Error::Value { name: "sections", expected: "at most 16 GiB (1 GiB on 32 bits)", found });
    }
    let mut out = try_room(WHAT, length as usize)?;
    out.extend_from_slice(&MAGIC);
    out.extend_from_slice(&length.to_le_bytes());
    out.extend_from_slice(&VERSION.to_le_bytes());
    out.extend_from_slice(&(sections.len() as u32).to_le_bytes());
    out.extend_from_slice(&kind.0);
    out.extend_from_slice(&generation.to_le_bytes());
    for section in sections {
        out.extend_from_slice(&section.tag.0);
        out.extend_from_slice(&section.values.code().to_le_bytes());
        out.extend_from_slice(&[0; 4]);
        out.extend_from_slice(&(section.values.len() as u64).to_le_bytes());
    }
    for section in sections {
        stop.check()?;
        section.values.write(&mut out);
    }
    let digest = sha256(&out, stop)?;
    out.extend_from_slice(&digest);
    Ok(out)
}

/// The contents of a file with these bytes, which must be of this `kind`; `source` is how messages call it.
///
/// What is allocated is bounded by the number of bytes: every size is checked before it is used.
pub fn decode(source: &Path, bytes: &[u8], kind: Tag, stop: &Stop) -> Result<Container> {
    let refuse = |fault| refusal(source, fault);
    let found = bytes.len();
    let start = &bytes[..found.min(MAGIC.len())];
    if !MAGIC.starts_with(start) {
        return Err(refuse(if start.iter().all(|&byte| byte == 0) { Fault::Blank } else { Fault::Foreign }));
    }
    let Some((sealed, digest)) = bytes.split_last_chunk::<DIGEST>().filter(|(sealed, _)| sealed.len() >= HEADER) else {
        return Err(refuse(Fault::Truncated { found }));
    };
    let mut cursor = Cursor(&sealed[MAGIC.len()..]);
    let truncated = || refuse(Fault::Truncated { found });
    let declared = cursor.u64().ok_or_else(truncated)?;
    if declared != found as u64 {
        return Err(refuse(Fault::Length { declared, found }));
    }
    if sha256(sealed, stop)? != *digest {
        return Err(refuse(Fault::Checksum));
    }
    // From here on the file is as its writer made it, who may be of the future or malicious.
    let version = cursor.u32().ok_or_else(truncated)?;
    if version != VERSION {
        return Err(refuse(Fault::Version { found: version }));
    }
    let count = cursor.u32().ok_or_else(truncated)?;
    let name = cursor.array::<8>().ok_or_else(truncated)?;
    let own = Tag::read(name).ok_or_else(|| refuse(Fault::Name { bytes: name }))?;
    if own != kind {
        return Err(refuse(Fault::Kind { found: own.to_string(), expected: kind.to_string() }));
    }
    let generation = cursor.u64().ok_or_else(truncated)?;
    let table = table(source, &mut cursor, count)?;
    let mut sections = try_room(WHAT, table.len())?;
    for entry in &table {
        stop.check()?;
        // the table has been found to fill the file exactly
        let raw = cursor.split(entry.size).ok_or_else(|| refuse(Fault::Sizes { tag: entry.tag.to_string() }))?;
        let (values, rest) = raw.split_at(entry.bytes);
        if rest.iter().any(|&byte| byte != 0) {
            return Err(refuse(Fault::Padding { tag: entry.tag.to_string() }));
        }
        sections.push(Section { tag: entry.tag, values: values_of(entry.code, values)? });
    }
    Ok(Container { source: source.into(), kind, generation, sections })
}

/// One line of the table.
struct Entry {
    tag: Tag,
    code: u32,
    /// Bytes of the elements.
    bytes: usize,
    /// The same with the padding.
    size: usize,
}

/// Reads the table and checks that the sections fill what remains, no more and no less.
fn table(source: &Path, cursor: &mut Cursor<'_>, count: u32) -> Result<Vec<Entry>> {
    let refuse = |fault| refusal(source, fault);
    let too_many = || refuse(Fault::Sections { found: count });
    if count > MAX_SECTIONS {
        return Err(too_many());
    }
    let mut raw = Cursor(cursor.split(count as usize * ENTRY).ok_or_else(too_many)?);
    let mut table = try_room(WHAT, count as usize)?;
    let mut left = cursor.0.len() as u64;
    for _ in 0..count {
        let name = raw.array::<8>().ok_or_else(too_many)?;
        let tag = Tag::read(name).ok_or_else(|| refuse(Fault::Name { bytes: name }))?;
        let [code, zero] = [raw.u32().ok_or_else(too_many)?, raw.u32().ok_or_else(too_many)?];
        let count = raw.u64().ok_or_else(too_many)?;
        let width = width(code).ok_or_else(|| refuse(Fault::Element { tag: tag.to_string(), code }))?;
        if zero != 0 {
            return Err(refuse(Fault::Padding { tag: tag.to_string() }));
        }
        let sizes = || refuse(Fault::Sizes { tag: tag.to_string() });
        let size = padded(code, count).filter(|&size| size <= left).ok_or_else(sizes)?;
        left -= size;
        // both fit: they are at most `left`, which is the length of a slice
        table.push(Entry { tag, code, bytes: (count * width) as usize, size: size as usize });
    }
    if left != 0 {
        let tag = table.last().map_or_else(|| "none".into(), |entry| entry.tag.to_string());
        return Err(refuse(Fault::Sizes { tag }));
    }
    let mut tags = try_collect(WHAT, table.iter().map(|entry| entry.tag))?;
    tags.sort_unstable();
    match tags.windows(2).find(|pair| pair[0] == pair[1]) {
        Some(pair) => Err(refuse(Fault::Duplicate { tag: pair[0].to_string() })),
        None => Ok(table),
    }
}

/// Bytes of an element.
fn width(code: u32) -> Option<u64> {
    match code {
        1 => Some(1),
        2 | 3 => Some(8),
        _ => None,
    }
}

/// Bytes of a section with its padding, `None` for an unknown type or if they cannot be counted.
fn padded(code: u32, count: u64) -> Option<u64> {
    width(code)?.checked_mul(count)?.checked_next_multiple_of(8)
}

fn values_of(code: u32, raw: &[u8]) -> Result<Values<'static>> {
    let (eights, _) = raw.as_chunks::<8>();
    Ok(match code {
        1 => {
            let mut values = try_room(WHAT, raw.len())?;
            values.extend_from_slice(raw);
            Values::Bytes(values.into())
        }
        2 => {
            let mut values = try_room(WHAT, eights.len())?;
            values.extend(eights.iter().map(|eight| u64::from_le_bytes(*eight)));
            Values::Integers(values.into())
        }
        _ => {
            let mut values = try_room(WHAT, eights.len())?;
            values.extend(eights.iter().map(|eight| f64::from_le_bytes(*eight)));
            Values::Reals(values.into())
        }
    })
}

/// Reads forwards and never beyond the end.
struct Cursor<'a>(&'a [u8]);

impl<'a> Cursor<'a> {
    fn split(&mut self, len: usize) -> Option<&'a [u8]> {
        let (head, rest) = self.0.split_at_checked(len)?;
        self.0 = rest;
        Some(head)
    }

    fn array<const N: usize>(&mut self) -> Option<[u8; N]> {
        self.split(N)?.try_into().ok()
    }

    fn u32(&mut self) -> Option<u32> {
        self.array().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Option<u64> {
        self.array().map(u64::from_le_bytes)
    }
}
