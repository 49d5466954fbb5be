//! Every truncation, every flipped bit, every forged size of a small state is refused by name.

use std::path::Path;

use proptest::prelude::*;

use super::super::format::{MAX_BYTES, SMALLEST};
use super::super::sha256::sha256;
use super::*;
use crate::memory::tests::counted;
use crate::storage::{Container, Fault, MAX_SECTIONS, VERSION, decode, encode};
use crate::{Error, Result};

const TABLE: usize = 40;
const DIGEST: usize = 32;

fn good() -> Vec<u8> {
    encode(tag("example"), 7, &example(), &go()).unwrap()
}

/// What is read, after a look at the memory that this took: a small multiple of the file, whatever the file says.
fn read(bytes: &[u8]) -> Result<Container> {
    let (result, asked) = counted(|| decode(Path::new("x"), bytes, tag("example"), &go()));
    assert!(asked <= 8 * bytes.len() + 256, "{asked} bytes for a file of {}", bytes.len());
    result
}

fn fault(bytes: &[u8]) -> Fault {
    match read(bytes) {
        Err(Error::State { path, fault, previous: None }) if path == Path::new("x") => fault,
        other => panic!("expected a fault, got {other:?}"),
    }
}

/// Makes length and checksum right again, as a forger would.
fn reseal(mut bytes: Vec<u8>) -> Vec<u8> {
    let found = bytes.len();
    bytes[8..16].copy_from_slice(&(found as u64).to_le_bytes());
    let digest = sha256(&bytes[..found - DIGEST], &go()).unwrap();
    bytes[found - DIGEST..].copy_from_slice(&digest);
    bytes
}

/// A good file with other bytes somewhere, resealed.
fn forged(at: usize, bytes: &[u8]) -> Vec<u8> {
    let mut file = good();
    file[at..at + bytes.len()].copy_from_slice(bytes);
    reseal(file)
}

#[test]
fn what_goes_in_comes_out_bit_for_bit() {
    let bytes = good();
    let found = read(&bytes).unwrap();
    assert_eq!((found.kind, found.generation), (tag("example"), 7));
    let bits = |values: &[f64]| values.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
    let Values::Reals(reals) = &example()[0].values else { panic!() };
    assert_eq!(bits(found.reals("reals").unwrap()), bits(reals));
    assert_eq!(found.integers("count").unwrap(), [u64::MAX, 0, 1 << 53]);
    assert_eq!(found.bytes("note").unwrap(), b"abc");
    assert_eq!(found.reals("nothing").unwrap(), [0.0; 0]);
    // one content, one file
    assert_eq!(encode(found.kind, 7, &found.sections, &go()).unwrap(), bytes);
    assert_eq!(bytes.len(), TABLE + 4 * 24 + 40 + 24 + 8 + DIGEST);
    assert_eq!(bytes.len() % 8, 0);
}

#[test]
fn no_sections_at_all() {
    let bytes = encode(tag("example"), 1, &[], &go()).unwrap();
    assert_eq!(bytes.len(), SMALLEST);
    assert_eq!(read(&bytes).unwrap().sections, []);
}

#[test]
fn every_truncation_is_refused() {
    let bytes = good();
    for len in 0..bytes.len() {
        let declared = bytes.len() as u64;
        let truncated = Fault::Truncated { found: len };
        let expected = if len < SMALLEST { truncated } else { Fault::Length { declared, found: len } };
        assert_eq!(fault(&bytes[..len]), expected, "{len} bytes");
    }
}

#[test]
fn every_flipped_bit_is_refused() {
    let bytes = good();
    for bit in 0..bytes.len() * 8 {
        let mut flipped = bytes.clone();
        flipped[bit / 8] ^= 1 << (bit % 8);
        let found = fault(&flipped);
        match bit / 64 {
            0 => assert_eq!(found, Fault::Foreign, "bit {bit}"),
            1 => assert!(matches!(found, Fault::Length { .. }), "bit {bit}: {found}"),
            _ => assert_eq!(found, Fault::Checksum, "bit {bit}"),
        }
    }
}

#[test]
fn more_bytes_are_refused() {
    for more in [1, 8, 1 << 20] {
        let mut bytes = good();
        let declared = bytes.len() as u64;
        bytes.resize(bytes.len() + more, 0);
        assert_eq!(fault(&bytes), Fault::Length { declared, found: bytes.len() });
    }
}

#[test]
fn other_files_are_told_from_damaged_ones() {
    assert_eq!(fault(b"\x80\x04\x95 a pickle"), Fault::Foreign);
    assert_eq!(fault(&[b'h'; 4096]), Fault::Foreign);
    assert_eq!(fault(&[0; 4096]), Fault::Blank);
    assert!(Fault::Blank.is_damage() && !Fault::Version { found: 2 }.is_damage());
}

#[test]
fn other_versions_are_refused_with_their_number() {
    for version in [0, VERSION + 1, VERSION.swap_bytes(), u32::MAX] {
        assert_eq!(fault(&forged(16, &version.to_le_bytes())), Fault::Version { found: version });
    }
    let message = read(&forged(16, &2u32.to_le_bytes())).unwrap_err().to_string();
    assert_eq!(message, "\"x\" has format version 2, and this release reads version 1");
}

#[test]
fn other_kinds_are_refused_with_their_name() {
    let expected = Fault::Kind { found: "other".into(), expected: "example".into() };
    assert_eq!(fault(&forged(24, b"other   ")), expected);
    for name in [b"        ", b" example", b"exam le ", b"exampl\xe9 ", b"example\0"] {
        assert_eq!(fault(&forged(24, name)), Fault::Name { bytes: *name });
    }
}

/// Well-sealed files with sizes that would overflow, overlap, leave gaps or ask for all memory.
#[test]
fn forged_tables_are_refused_before_anything_is_allocated() {
    for count in [MAX_SECTIONS + 1, u32::MAX, 9] {
        // 9 entries would reach beyond the end of this file
        assert_eq!(fault(&forged(20, &count.to_le_bytes())), Fault::Sections { found: count });
    }
    let reals = |size: u64| fault(&forged(TABLE + 16, &size.to_le_bytes()));
    for size in [u64::MAX, 1 << 63, 1 << 61, (1 << 61) + 5, 1 << 40, 10] {
        assert_eq!(reals(size), Fault::Sizes { tag: "reals".into() });
    }
    // a size that fits steals from the sections that follow
    assert_eq!(reals(6), Fault::Sizes { tag: "note".into() });
    assert_eq!(reals(4), Fault::Sizes { tag: "nothing".into() });
    for code in [0, 4, u32::MAX] {
        assert_eq!(fault(&forged(TABLE + 8, &code.to_le_bytes())), Fault::Element { tag: "reals".into(), code });
    }
    assert_eq!(fault(&forged(TABLE + 12, &[1])), Fault::Padding { tag: "reals".into() });
    assert_eq!(fault(&forged(TABLE + 24, b"reals   ")), Fault::Duplicate { tag: "reals".into() });
    let padding = good().len() - DIGEST - 1; // behind "abc"
    assert_eq!(fault(&forged(padding, &[1])), Fault::Padding { tag: "note".into() });
    // a count of fewer sections leaves bytes that belong to none
    assert!(matches!(fault(&forged(20, &3u32.to_le_bytes())), Fault::Sizes { .. }));
}

#[test]
fn wrong_sections_are_not_written() {
    let one = |name: &str| section(name, Values::Bytes(vec![1].into()));
    let refused = encode(tag("k"), 1, &[one("a"), one("b"), one("a")], &go());
    assert!(matches!(refused, Err(Error::Value { name: "sections", .. })), "{refused:?}");
    let many: Vec<_> = (0..=MAX_SECTIONS).map(|i| one(&format!("s{i}"))).collect();
    assert!(matches!(encode(tag("k"), 1, &many, &go()), Err(Error::Value { name: "sections", .. })));
    assert!(encode(tag("k"), 1, &many[1..], &go()).is_ok());
    for name in ["", " ", "a b", "ninebytes", "é", "a ", " a", "a\0", "a\n"] {
        assert!(matches!(Tag::new(name), Err(Error::Value { name: "tag", .. })), "{name:?}");
    }
    assert_eq!(format!("{:?} {}", tag("x0"), tag("a-b_c.d8")), "Tag(x0) a-b_c.d8");
    const { assert!(MAX_BYTES <= isize::MAX as u64) }
}

#[test]
fn a_reader_asks_for_names_and_types() {
    let found = read(&good()).unwrap();
    assert!(matches!(found.reals("count"), Err(Error::State { fault: Fault::Missing { .. }, .. })));
    assert!(matches!(found.integers("none"), Err(Error::State { fault: Fault::Missing { .. }, .. })));
    assert!(matches!(found.bytes("reals"), Err(Error::State { fault: Fault::Missing { .. }, .. })));
    assert_eq!(found.refuse("a weight of -1").to_string(), "\"x\" has contents that cannot be: a weight of -1");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    #[test]
    fn garbage_never_panics(bytes in proptest::collection::vec(any::<u8>(), 0..400), start in 0usize..41) {
        prop_assert!(read(&bytes).is_err());
        // behind a good beginning and well sealed, it comes as far as it can
        let mut file = good()[..start].to_vec();
        file.extend(bytes);
        file.resize(file.len().max(SMALLEST), 0);
        let file = reseal(file);
        if let Ok(found) = read(&file) {
            prop_assert_eq!(encode(found.kind, found.generation, &found.sections, &go()).unwrap(), file);
        }
    }

    #[test]
    fn forged_files_are_refused_or_canonical(
        changes in proptest::collection::vec((16usize..208, prop_oneof![Just(0u8), Just(1), Just(255), any::<u8>()]), 1..6)
    ) {
        let mut file = good();
        for (at, byte) in changes {
            file[at] = byte;
        }
        let file = reseal(file);
        if let Ok(found) = read(&file) {
            prop_assert_eq!(encode(found.kind, found.generation, &found.sections, &go()).unwrap(), file);
        }
    }
}
