//! The container of a state: named arrays of bytes, integers and reals as a safetensors file, sealed with a digest.
//!
//! ```text
//! 0    length of the header, u64
//! 8    the header, JSON, padded with spaces to a multiple of 8:
//!      {"__metadata__":{"format":"stochens","sha256":"...","version":"2","kind":"...","generation":"7"},
//!       "name":{"dtype":"F64","shape":[5],"data_offsets":[0,40]}, ...}
//! then the arrays, little-endian, without gaps
//! ```
//!
//! The digest is that of the whole file with 64 zeros in its own place. Everything up to the version has the same place
//! in all versions, so that damage can be told from a file of a later version. The same contents always give the same
//! bytes, and any other bytes are refused: no name can occur twice, and nothing can be hidden between the arrays.

use std::borrow::{Borrow, Cow};
use std::cmp::Ordering;
use std::path::{Path, PathBuf};

use safetensors::Dtype;
use safetensors::tensor::Metadata;
use sha2::{Digest, Sha256};

use crate::error::{Error, Result};
use crate::fault::{Fault, MAX_BYTES, VERSION};
use crate::memory::{covered, try_collect, try_room};
use crate::parallel::Stop;

/// The purpose of memory, in error messages.
pub(super) const WHAT: &str = "a state";

/// Longest header, which limits the memory of the parser.
pub const MAX_HEADER: u64 = 1 << 20;

/// Upper bound on the memory of the parser per byte of a header: it needs 64 bytes for `[[[...]]]`, since each pair of
/// brackets gets room for four entries of 32 bytes.
pub(super) const PARSED: usize = 96;

/// The beginning of every header, then the digest.
pub(super) const BEGINNING: &str = r#"{"__metadata__":{"format":"stochens","sha256":""#;
/// Where the digest begins, in hexadecimal digits.
pub(super) const SEAL: usize = 8 + BEGINNING.len();
pub(super) const ZEROS: &[u8] = &[b'0'; 64];
const SEALED: usize = SEAL + ZEROS.len();

/// Bytes between two checks of the stop flag: a few milliseconds of work.
const BLOCK: usize = 1 << 20;

/// The elements of a section.
#[derive(Debug, Clone, PartialEq)]
pub enum Values<'a> {
    /// Unsigned 8-bit integers.
    Bytes(Cow<'a, [u8]>),
    /// Unsigned 64-bit integers.
    Integers(Cow<'a, [u64]>),
    /// Doubles, bit for bit.
    Reals(Cow<'a, [f64]>),
}

impl Values<'_> {
    /// Type, number of elements, bytes.
    fn size(&self) -> (Dtype, usize, usize) {
        match self {
            Self::Bytes(values) => (Dtype::U8, values.len(), size_of_val(&values[..])),
            Self::Integers(values) => (Dtype::U64, values.len(), size_of_val(&values[..])),
            Self::Reals(values) => (Dtype::F64, values.len(), size_of_val(&values[..])),
        }
    }

    fn write(&self, out: &mut Vec<u8>) {
        match self {
            Self::Bytes(values) => out.extend_from_slice(values),
            Self::Integers(values) => values.iter().for_each(|value| out.extend_from_slice(&value.to_le_bytes())),
            Self::Reals(values) => values.iter().for_each(|value| out.extend_from_slice(&value.to_le_bytes())),
        }
    }

    /// The elements of this type with these bytes; `None` for other types.
    fn read(dtype: Dtype, raw: &[u8]) -> Result<Option<Values<'static>>> {
        Ok(match dtype {
            Dtype::U8 => Some(Values::Bytes(array(raw, u8::from_le_bytes)?)),
            Dtype::U64 => Some(Values::Integers(array(raw, u64::from_le_bytes)?)),
            Dtype::F64 => Some(Values::Reals(array(raw, f64::from_le_bytes)?)),
            _ => None,
        })
    }
}

fn array<T: Clone, const N: usize>(raw: &[u8], one: fn([u8; N]) -> T) -> Result<Cow<'static, [T]>> {
    let (chunks, _) = raw.as_chunks();
    Ok(try_collect(WHAT, chunks.iter().map(|chunk| one(*chunk)))?.into())
}

/// A named array.
#[derive(Debug, Clone, PartialEq)]
pub struct Section<'a> {
    /// Its name, unique in the file: 1 to 64 letters, digits, `_`, `-` or `.`, the first no `_`.
    pub name: Cow<'a, str>,
    /// Its elements.
    pub values: Values<'a>,
}

/// What a state file contains.
#[derive(Debug, Clone, PartialEq)]
pub struct Container {
    /// The source in error messages.
    pub source: PathBuf,
    /// The kind of the state.
    pub kind: String,
    /// 1 for the first state saved under a path, then one more each time.
    pub generation: u64,
    /// The arrays: integers, doubles, bytes, and each of these by name.
    pub sections: Vec<Section<'static>>,
}

impl Container {
    /// The elements of the section called `name`, if there is one.
    pub fn values(&self, name: &str) -> Option<&Values<'static>> {
        self.sections.iter().find(|section| section.name == name).map(|section| &section.values)
    }
}

pub(super) fn refusal(source: &Path, fault: Fault) -> Error {
    Error::State { path: source.into(), fault, previous: None }
}

/// Refuses names that are not allowed in a file.
pub(super) fn check_names(kind: &str, sections: &[Section<'_>]) -> Result<()> {
    let wrong = |argument, name: &str| {
        let expected = "1 to 64 letters, digits, '_', '-' or '.', not starting with '_'";
        Err(Error::Value { name: argument, expected, found: format!("\"{}\"", one_line(name)) })
    };
    if !is_name(kind) {
        return wrong("kind", kind);
    }
    let mut names = try_collect(WHAT, sections.iter().map(|section| &*section.name))?;
    names.sort_unstable();
    if let Some(name) = names.iter().find(|name| !is_name(name)) {
        return wrong("name", name);
    }
    match names.windows(2).find(|pair| pair[0] == pair[1]) {
        Some(pair) => {
            let found = format!("'{}' twice", pair[0]);
            Err(Error::Value { name: "sections", expected: "with different names", found })
        }
        None => Ok(()),
    }
}

fn is_name(name: &str) -> bool {
    let good = |byte: u8| byte.is_ascii_alphanumeric() || b"_-.".contains(&byte);
    // "__metadata__" is reserved
    (1..=64).contains(&name.len()) && name.bytes().all(good) && !name.starts_with('_')
}

/// The order in a file: elements of eight bytes first, so that all are aligned; then by name.
fn order(a: &Section<'_>, b: &Section<'_>) -> Ordering {
    b.values.size().0.cmp(&a.values.size().0).then_with(|| a.name.cmp(&b.name))
}

/// The one header of a file with these contents, its length included.
fn header<'a, S: Borrow<Section<'a>>>(kind: &str, generation: u64, seal: &[u8], sections: &[S]) -> Result<Vec<u8>> {
    // three numbers of 20 digits and 49 other characters
    let room = sections.iter().map(|section| section.borrow().name.len() + 109).sum::<usize>();
    let mut out = try_room(WHAT, 8 + BEGINNING.len() + seal.len() + kind.len() + 100 + room)?;
    out.extend_from_slice(&[0; 8]);
    out.extend_from_slice(BEGINNING.as_bytes());
    out.extend_from_slice(seal);
    let own = format!(r#"","version":"{VERSION}","kind":"{kind}","generation":"{generation}"}}"#);
    out.extend_from_slice(own.as_bytes());
    let mut start = 0;
    for Section { name, values } in sections.iter().map(Borrow::borrow) {
        let (dtype, len, bytes) = values.size();
        let end = start + bytes as u64;
        let entry = format!(r#","{name}":{{"dtype":"{dtype}","shape":[{len}],"data_offsets":[{start},{end}]}}"#);
        out.extend_from_slice(entry.as_bytes());
        start = end;
    }
    out.push(b'}');
    out.resize(out.len().next_multiple_of(8), b' ');
    let length = out.len() as u64 - 8;
    out[..8].copy_from_slice(&length.to_le_bytes());
    Ok(out)
}

/// SHA-256 of a file with zeros in the place of the digest, in hexadecimal digits.
pub(super) fn digest(bytes: &[u8], stop: &Stop) -> Result<Vec<u8>> {
    let mut hash = Sha256::new_with_prefix(&bytes[..SEAL]);
    hash.update(ZEROS);
    for block in bytes[SEALED..].chunks(BLOCK) {
        stop.check()?;
        hash.update(block);
    }
    let mut digits = try_room(WHAT, ZEROS.len())?;
    hash.finalize().iter().for_each(|byte| digits.extend_from_slice(format!("{byte:02x}").as_bytes()));
    Ok(digits)
}

/// The bytes of a file with these contents.
pub fn encode(kind: &str, generation: u64, sections: &[Section<'_>], stop: &Stop) -> Result<Vec<u8>> {
    check_names(kind, sections)?;
    let mut sorted = try_collect(WHAT, sections)?;
    sorted.sort_unstable_by(|a, b| order(a, b));
    let header = header(kind, generation, ZEROS, &sorted)?;
    let length =
        sorted.iter().map(|section| section.values.size().2 as u64).fold(header.len() as u64, u64::saturating_add);
    let wrong = |expected, found| Err(Error::Value { name: "sections", expected, found });
    if header.len() as u64 - 8 > MAX_HEADER {
        return wrong("few enough for a header of 1 MiB", format!("{} in {} bytes", sections.len(), header.len()));
    }
    if length > MAX_BYTES {
        return wrong("at most 16 GiB (1 GiB on 32 bits)", format!("{length} bytes"));
    }
    let mut out = try_room(WHAT, length as usize)?;
    out.extend_from_slice(&header);
    for section in sorted {
        stop.check()?;
        section.values.write(&mut out);
    }
    let seal = digest(&out, stop)?;
    out[SEAL..SEALED].copy_from_slice(&seal);
    Ok(out)
}

/// The contents of a file with these bytes, which must be of this `kind`; `source` is its name in messages.
///
/// The memory is bounded by the number of bytes: every size is checked before it is used.
pub fn decode(source: &Path, bytes: &[u8], kind: &str, stop: &Stop) -> Result<Container> {
    let refuse = |fault| refusal(source, fault);
    let found = bytes.len();
    let start = &bytes[..found.min(SEAL)];
    if start.iter().all(|&byte| byte == 0) {
        return Err(refuse(Fault::Blank));
    }
    if start.get(8..) != Some(BEGINNING.as_bytes()) {
        return Err(refuse(Fault::Foreign));
    }
    let Some(seal) = bytes.get(SEAL..SEALED) else { return Err(refuse(Fault::Truncated { found })) };
    if digest(bytes, stop)? != seal {
        // the digest shows damage; the header may say more precisely what is wrong
        return Err(parse(source, bytes).err().unwrap_or_else(|| refuse(Fault::Checksum)));
    }
    // From here on the file is as it was written, but perhaps by a later version or with bad intent.
    match version(&bytes[SEALED..]) {
        Some(VERSION) => {}
        Some(found) => return Err(refuse(Fault::Version { found })),
        None => return Err(refuse(Fault::Header("no version".into()))),
    }
    let (metadata, names, data) = parse(source, bytes)?;
    let mut sections = try_room(WHAT, names.len())?;
    for name in names {
        stop.check()?;
        let Some(info) = metadata.info(&name) else { continue };
        // `safetensors` has checked that the offsets lie within the data, follow each other, and fit type and shape
        let raw = &data[info.data_offsets.0..info.data_offsets.1];
        let Some(values) = Values::read(info.dtype, raw)?.filter(|_| info.shape.len() == 1) else {
            let (dtype, dimensions) = (info.dtype, info.shape.len());
            return Err(refuse(Fault::Element { name: one_line(&name), dtype, dimensions }));
        };
        sections.push(Section { name: name.into(), values });
    }
    sections.sort_unstable_by(order);
    let own = |key| metadata.metadata().as_ref().and_then(|own| own.get(key)).map_or("", String::as_str);
    let (found, generation) = (own("kind"), own("generation").parse().unwrap_or(0));
    let named = is_name(found) && sections.iter().all(|section| is_name(&section.name));
    if !named || !bytes.starts_with(&header(found, generation, seal, &sections)?) {
        return Err(refuse(Fault::Canonical));
    }
    if found != kind {
        return Err(refuse(Fault::Kind { found: found.into(), expected: kind.into() }));
    }
    Ok(Container { source: source.into(), kind: kind.into(), generation, sections })
}

/// The version, right behind the digest.
fn version(bytes: &[u8]) -> Option<u64> {
    let digits = bytes.strip_prefix(br#"","version":""#)?.split(|&byte| byte == b'"').next()?;
    str::from_utf8(digits.get(..20).unwrap_or(digits)).ok()?.parse().ok()
}

/// The parsed header, the names in it, and the data, which fill the file exactly.
fn parse<'a>(source: &Path, bytes: &'a [u8]) -> Result<(Metadata, Vec<String>, &'a [u8])> {
    let refuse = |fault| refusal(source, fault);
    let found = bytes.len();
    let (length, rest) = bytes.split_first_chunk().ok_or_else(|| refuse(Fault::Truncated { found }))?;
    let length = u64::from_le_bytes(*length);
    if length > MAX_HEADER {
        return Err(refuse(Fault::Header(format!("{length} bytes, and at most {MAX_HEADER} are allowed"))));
    }
    let (header, data) = rest.split_at_checked(length as usize).ok_or_else(|| refuse(Fault::Truncated { found }))?;
    let read = covered(WHAT, PARSED as u128 * u128::from(length), || {
        let metadata: Metadata = serde_json::from_slice(header).map_err(|error| one_line(&error.to_string()))?;
        let names = metadata.offset_keys();
        Ok((metadata, names))
    })?;
    let (metadata, names) = read.map_err(|why| refuse(Fault::Header(why)))?;
    if metadata.data_len() != data.len() {
        let declared = (8 + length).saturating_add(metadata.data_len() as u64);
        return Err(refuse(Fault::Length { declared, found }));
    }
    Ok((metadata, names, data))
}

/// A text from a file, shortened for a message.
fn one_line(text: &str) -> String {
    String::from_iter(text.chars().take(100).flat_map(char::escape_debug))
}
