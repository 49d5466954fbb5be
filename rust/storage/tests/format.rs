//! Every truncation, every flipped bit and every forged header of a small state is refused with the right fault.

use std::path::Path;

use proptest::prelude::*;
use safetensors::{Dtype, SafeTensors};

use super::super::format::{BEGINNING, PARSED, SEAL, ZEROS, digest};
use super::*;
use crate::fault::MAX_BYTES;
use crate::memory::tests::counted;
use crate::storage::{Container, Fault, MAX_HEADER, VERSION, decode, encode};
use crate::{Error, Result};

fn good() -> Vec<u8> {
    encode("example", 7, &example(), &go()).unwrap()
}

/// Where the data begins.
fn behind_header(bytes: &[u8]) -> usize {
    8 + u64::from_le_bytes(bytes[..8].try_into().unwrap()) as usize
}

/// Reads the bytes, and checks that the memory is a small multiple of the file, whatever the file says.
fn read(bytes: &[u8]) -> Result<Container> {
    let (result, asked) = counted(|| decode(Path::new("x"), bytes, "example", &go()));
    // twice as many as for the parser: what it asks for, after as many have been asked for and given back
    let most = 2 * PARSED * bytes.len().min(MAX_HEADER as usize + 8) + 2 * bytes.len() + 2000;
    assert!(asked <= most, "{asked} bytes for a file of {}", bytes.len());
    result
}

fn fault(bytes: &[u8]) -> Fault {
    match read(bytes) {
        Err(Error::State { path, fault, previous: None }) if path == Path::new("x") => fault,
        other => panic!("expected a fault, got {other:?}"),
    }
}

/// Makes the digest right again, as a forger would.
fn reseal(mut bytes: Vec<u8>) -> Vec<u8> {
    let seal = digest(&bytes, &go()).unwrap();
    bytes[SEAL..SEAL + ZEROS.len()].copy_from_slice(&seal);
    bytes
}

/// A file with a correct digest, any text behind the version, and any data.
fn forged(header: &str, data: &[u8]) -> Vec<u8> {
    let header = format!("{BEGINNING}{:064}\",\"version\":\"2\"{header}", 0);
    reseal([&(header.len() as u64).to_le_bytes()[..], header.as_bytes(), data].concat())
}

/// A good file with one text of its header replaced by another, padded again and resealed.
fn altered(from: &str, to: &str) -> Vec<u8> {
    let bytes = good();
    let (head, data) = bytes.split_at(behind_header(&bytes));
    let head = str::from_utf8(&head[8..]).unwrap().trim_end_matches(' ');
    assert_eq!(head.matches(from).count(), 1, "{from}");
    let mut head = head.replace(from, to);
    head.push_str(&" ".repeat(head.len().next_multiple_of(8) - head.len()));
    reseal([&(head.len() as u64).to_le_bytes()[..], head.as_bytes(), data].concat())
}

#[test]
fn what_goes_in_comes_out_bit_for_bit() {
    let bytes = good();
    let found = read(&bytes).unwrap();
    assert_eq!((&*found.kind, found.generation), ("example", 7));
    let bits = |values: &[f64]| values.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
    let Values::Reals(expected) = &example()[0].values else { panic!() };
    assert_eq!(bits(reals(&found, "reals")), bits(expected));
    assert_eq!(found.values("count"), Some(&example()[1].values));
    assert_eq!(found.values("note"), Some(&example()[2].values));
    assert_eq!(reals(&found, "nothing"), [0.0; 0]);
    // the order of the sections does not change the file
    assert_eq!(encode("example", 7, &found.sections, &go()).unwrap(), bytes);
    assert_eq!(found.sections.iter().map(|s| &*s.name).collect::<Vec<_>>(), ["count", "nothing", "reals", "note"]);
    assert_eq!(behind_header(&bytes) % 8, 0);
    assert_eq!(bytes.len() - behind_header(&bytes), 24 + 40 + 3);
}

/// The `safetensors` crate reads what we write, and would write the same.
#[test]
fn the_data_are_those_of_any_writer() {
    let bytes = good();
    let found = SafeTensors::deserialize(&bytes).unwrap();
    let theirs = safetensors::serialize(found.iter(), None).unwrap();
    let data = behind_header(&bytes);
    assert_eq!(theirs[behind_header(&theirs)..], bytes[data..]);
    let table = |file: &[u8]| str::from_utf8(&file[8..behind_header(file)]).unwrap().trim_end().to_owned();
    assert_eq!(table(&bytes).split_once("},").unwrap().1, &table(&theirs)[1..]);
}

#[test]
fn no_sections_at_all() {
    let bytes = encode("example", 1, &[], &go()).unwrap();
    assert_eq!(bytes.len(), behind_header(&bytes));
    assert_eq!(read(&bytes).unwrap().sections, []);
}

#[test]
fn every_truncation_is_refused() {
    let bytes = good();
    for len in 0..bytes.len() {
        let expected = match len {
            0 => Fault::Blank,
            _ if len < SEAL => Fault::Foreign, // it may be any file
            _ if len < behind_header(&bytes) => Fault::Truncated { found: len },
            _ => Fault::Length { declared: bytes.len() as u64, found: len },
        };
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
        match bit / 8 {
            0..8 => assert!(matches!(found, Fault::Header(_) | Fault::Truncated { .. }), "bit {bit}: {found}"),
            8..SEAL => assert_eq!(found, Fault::Foreign, "bit {bit}"),
            at if at < behind_header(&bytes) => {
                let known = matches!(found, Fault::Checksum | Fault::Header(_) | Fault::Length { .. });
                assert!(known, "bit {bit}: {found}");
            }
            _ => assert_eq!(found, Fault::Checksum, "bit {bit}"),
        }
        assert!(found.is_damage());
    }
}

#[test]
fn more_bytes_are_refused() {
    for more in [1, 8, 1 << 20] {
        let mut bytes = good();
        let declared = bytes.len() as u64;
        bytes.resize(bytes.len() + more, 0);
        let expected = Fault::Length { declared, found: bytes.len() };
        assert_eq!(fault(&bytes), expected);
        assert_eq!(fault(&reseal(bytes)), expected);
    }
}

#[test]
fn other_files_are_told_from_damaged_ones() {
    assert_eq!(fault(b"\x80\x04\x95 a pickle"), Fault::Foreign);
    assert_eq!(fault(&[b'h'; 4096]), Fault::Foreign);
    let theirs = safetensors::serialize(SafeTensors::deserialize(&good()).unwrap().iter(), None).unwrap();
    assert_eq!(fault(&theirs), Fault::Foreign);
    assert_eq!(fault(&[0; 4096]), Fault::Blank);
    assert!(Fault::Blank.is_damage() && !Fault::Version { found: 3 }.is_damage());
}

#[test]
fn other_versions_are_refused_with_their_number() {
    for version in [0, VERSION - 1, VERSION + 1, u64::MAX] {
        let file = altered(r#""version":"2""#, &format!(r#""version":"{version}""#));
        assert_eq!(fault(&file), Fault::Version { found: version });
    }
    let message = read(&altered(r#""version":"2""#, r#""version":"3""#)).unwrap_err().to_string();
    assert_eq!(message, "\"x\" has format version 3, but this release reads version 2");
    // whatever else a future header says
    let future = altered(r#""version":"2","kind":"example""#, r#""version":"3","kind":{}"#);
    assert_eq!(fault(&future), Fault::Version { found: 3 });
    for none in [r#""version":"""#, r#""version":"two""#, r#""version": "2""#, r#""version":2"#] {
        assert_eq!(fault(&altered(r#""version":"2""#, none)), Fault::Header("no version".into()), "{none}");
    }
}

#[test]
fn other_kinds_are_refused_with_their_name() {
    let expected = Fault::Kind { found: "other".into(), expected: "example".into() };
    assert_eq!(fault(&altered(r#""kind":"example""#, r#""kind":"other""#)), expected);
    let long = "x".repeat(65);
    for name in ["", " example", "_example", r"exam\nle", "exampl\u{e9}", &long] {
        assert_eq!(fault(&altered(r#""kind":"example""#, &format!(r#""kind":"{name}""#))), Fault::Canonical);
    }
}

/// Files with a correct digest and sizes that would overflow, overlap, leave gaps or need all memory.
#[test]
fn forged_sizes_are_refused_before_anything_is_allocated() {
    for length in [u64::MAX, 1 << 63, MAX_HEADER + 1] {
        let mut file = good();
        file[..8].copy_from_slice(&length.to_le_bytes());
        let expected = format!("{length} bytes, and at most 1048576 are allowed");
        assert_eq!(fault(&reseal(file)), Fault::Header(expected));
    }
    let mut file = good();
    file[..8].copy_from_slice(&MAX_HEADER.to_le_bytes());
    let found = file.len();
    assert_eq!(fault(&reseal(file)), Fault::Truncated { found });
    // "reals" has 5 doubles in the bytes 24 to 64
    let reals = |shape: &str, offsets: &str| {
        let from = r#""shape":[5],"data_offsets":[24,64]"#;
        match fault(&altered(from, &format!(r#""shape":[{shape}],"data_offsets":[{offsets}]"#))) {
            Fault::Header(why) => why,
            other => panic!("{shape} {offsets}: {other}"),
        }
    };
    for (shape, offsets, why) in [
        ("5", "24,63", "invalid shape"),
        ("4", "24,64", "invalid shape"),
        ("4", "24,56", "invalid offset for tensor `note`"),
        ("5", "16,56", "invalid offset for tensor"), // overlaps what is before it
        ("5", "25,65", "invalid offset for tensor"), // leaves a gap
        ("5", "64,24", "invalid offset for tensor"),
        ("5", "0,40", "invalid offset for tensor"),
        ("18446744073709551615", "24,64", "overflow"),
        ("4294967296,4294967296", "24,64", "overflow"),
        ("2305843009213693952", "24,64", "overflow"), // times 8 is 0
        ("5", "24,18446744073709551615", "invalid shape"),
        ("18446744073709551616", "24,64", "invalid type"),
        ("-1", "24,64", "invalid value"),
        ("5.0", "24,64", "invalid type"),
        ("5", "24", "invalid length"),
        ("[5]", "24,64", "invalid type"),
    ] {
        let found = reals(shape, offsets);
        assert!(found.contains(why), "{shape} {offsets}: {found}");
    }
    // sizes that fit each other, but not the file
    let all = |sizes: &[u64]| {
        let mut start = 0;
        let table = sizes.iter().enumerate().map(|(i, len)| {
            let end = start + len;
            let offsets = format!("[{},{end}]", std::mem::replace(&mut start, end));
            format!(r#","{i}":{{"dtype":"U8","shape":[{len}],"data_offsets":{offsets}}}"#)
        });
        format!(r#","kind":"example","generation":"7"}}{}}}"#, table.collect::<String>())
    };
    for len in [0, 2, 4, 1 << 40, (1 << 61) - 1] {
        assert!(matches!(fault(&forged(&all(&[len]), b"abc")), Fault::Length { .. }), "{len}");
    }
    let largest = [(1 << 61) - 1; 8].into_iter().chain([7]).collect::<Vec<_>>();
    assert_eq!(largest.iter().sum::<u64>(), u64::MAX);
    assert!(matches!(fault(&forged(&all(&largest), b"abc")), Fault::Length { declared: u64::MAX, .. }));
    for len in [1 << 61, u64::MAX] {
        assert!(matches!(fault(&forged(&all(&[len]), b"abc")), Fault::Header(why) if why.contains("overflow")));
    }
    assert_eq!(fault(&forged(&all(&[3]), b"abc")), Fault::Canonical); // but for the padding of the header
}

#[test]
fn forged_types_are_refused() {
    let note = |dtype: &str, shape: &str| {
        fault(&altered(r#"{"dtype":"U8","shape":[3]"#, &format!(r#"{{"dtype":"{dtype}","shape":[{shape}]"#)))
    };
    for dtype in ["F128", "u8", "", "\\u0055\\u0038x", &"long ".repeat(1000)] {
        match note(dtype, "3") {
            Fault::Header(why) => assert!(why.starts_with("unknown variant") && why.len() <= 600, "{why}"),
            other => panic!("{other}"),
        }
    }
    for dtype in ["I8", "BOOL", "F8_E4M3"] {
        let found = note(dtype, "3").to_string();
        let told = "must be U8, U64 or F64 and one";
        assert_eq!(found, format!("has a section 'note' of type {dtype} and 1 dimensions: {told}"));
    }
    for shape in ["3,1", "1,1,3"] {
        assert!(matches!(note("U8", shape), Fault::Element { dimensions: 2.., .. }));
    }
    let scalar = altered(r#""shape":[0],"data_offsets":[24,24]"#, r#""shape":[],"data_offsets":[24,32]"#);
    assert!(matches!(fault(&scalar), Fault::Header(_)));
    let deep = |depth: usize| "[".repeat(depth);
    for text in
        [deep(100_000), format!(r#","kind":"example","x":{}"#, deep(500_000)), format!("}},\"x\":{}", deep(900_000))]
    {
        let Fault::Header(why) = fault(&forged(&text, &[])) else { panic!() };
        assert!(why.contains("recursion limit") || why.contains("invalid type") || why.contains("expected"), "{why}");
    }
    // what needs most memory in the parser, and fills the header
    let nested = format!("{}{},", "[".repeat(100), "]".repeat(100));
    for unit in ["0,", "[],", "[0],", "\"\",", "\"\\n\",", "{},", "{\"\":0},", &nested] {
        let many = unit.repeat((MAX_HEADER as usize - 200) / unit.len());
        assert!(matches!(fault(&forged(&format!("}},\"x\":[{many}0]}}"), &[])), Fault::Header(_)));
    }
    let many = "1,".repeat(MAX_HEADER as usize / 2 - 200);
    let dimensions = many.len() / 2 + 1;
    let table = format!(r#"}},"x":{{"dtype":"U8","shape":[{many}1],"data_offsets":[0,1]}}}}"#);
    let expected = Fault::Element { name: "x".into(), dtype: Dtype::U8, dimensions };
    assert_eq!(fault(&forged(&table, &[0])), expected);
    let many: String = (0..20_000).map(|i| format!(",\"{i}\":{{\"dtype\":\"U8\"}}")).collect();
    assert!(matches!(fault(&forged(&format!("}}{many}}}"), &[])), Fault::Header(_)));
}

/// Refused although a lenient parser would accept it: names that occur twice, and everything that is not in the format.
#[test]
fn only_one_header_is_accepted() {
    let twice = r#""note":{"dtype":"U8","shape":[3],"data_offsets":[64,67]}"#;
    for (from, to) in [
        (twice, &*format!("{twice},{twice}")),
        ("\"nothing\":", "\"reals\":"),
        ("\"note\":", "\"_note\":"),
        ("\"note\":", "\"no te\":"),
        ("\"note\":", "\"n\\u006fte\":"),
        ("\"note\":", "\"note\": "),
        ("\"note\":", "\"\":"),
        ("\"note\":", "\"\\\"\\n\":"),
        ("\"dtype\":\"U8\",\"shape\":[3]", "\"shape\":[3],\"dtype\":\"U8\""),
        ("\"dtype\":\"U8\"", "\"dtype\":\"U8\",\"x\":[{}]"),
        ("\"generation\":\"7\"", "\"generation\":\"07\""),
        ("\"generation\":\"7\"", "\"generation\":\"+7\""),
        ("\"generation\":\"7\"", "\"generation\":\"18446744073709551616\""),
        ("\"generation\":\"7\"", "\"more\":\"7\""),
        ("\"generation\":\"7\"", "\"generation\":\"7\",\"more\":\"\""),
        ("\"generation\":\"7\"", "\"generation\":\"7\",\"generation\":\"7\""),
        ("\"kind\":\"example\"", "\"like\":\"example\""),
    ] {
        assert_eq!(fault(&altered(from, to)), Fault::Canonical, "{to}");
    }
    let field = altered("\"dtype\":\"U8\"", "\"dtype\":\"U8\",\"dtype\":\"U8\"");
    assert!(matches!(fault(&field), Fault::Header(why) if why.starts_with("duplicate field `dtype`")));
    let own = altered("\"note\":", "\"__metadata__\":{},\"note\":");
    assert!(matches!(fault(&own), Fault::Header(why) if why.starts_with("duplicate field `__metadata__`")));
    // changes of only the order or the padding
    assert_eq!(fault(&altered("\"nothing\":", "\"z\":")), Fault::Canonical);
    let bytes = good();
    let (head, data) = bytes.split_at(behind_header(&bytes));
    for more in ["        ", "\n       "] {
        let length = (head.len() - 8 + more.len()) as u64;
        let file = [&length.to_le_bytes()[..], &head[8..], more.as_bytes(), data].concat();
        assert_eq!(fault(&reseal(file)), Fault::Canonical);
    }
}

#[test]
fn wrong_sections_are_not_written() {
    let one = |name: &str| section(name, Values::Bytes(vec![1].into()));
    let refused = |kind: &str, sections: &[Section<'_>]| match encode(kind, 1, sections, &go()) {
        Err(Error::Value { name, found, .. }) => (name, found),
        other => panic!("{other:?}"),
    };
    let real = section("a", Values::Reals(vec![1.0].into())); // of another type, hence in another place
    assert_eq!(refused("k", &[one("a"), one("b"), real]), ("sections", "'a' twice".into()));
    let many: Vec<_> = (0..20_000).map(|i| one(&format!("s{i}"))).collect();
    assert_eq!(refused("k", &many).0, "sections");
    let most = encode("example", 1, &many[..10_000], &go()).unwrap();
    assert_eq!(read(&most).unwrap().sections.len(), 10_000);
    let long = "x".repeat(65);
    for name in ["", " ", "a b", &long, "é", "a ", " a", "a\0", "a\n", "a\"", "a\\", "_a", "__metadata__"] {
        assert_eq!(refused(name, &[]).0, "kind", "{name:?}");
        assert_eq!(refused("k", &[one(name)]).0, "name", "{name:?}");
    }
    assert!(encode("k", 1, &[one("a-b_c.d8"), one(&long[1..])], &go()).is_ok());
    const { assert!(MAX_BYTES <= isize::MAX as u64) }
}

#[test]
fn a_stop_ends_it() {
    let stop = go();
    stop.request();
    assert_eq!(encode("example", 1, &example(), &stop), Err(Error::Interrupted));
    assert_eq!(decode(Path::new("x"), &good(), "example", &stop), Err(Error::Interrupted));
}

/// A file that can be read is the one that its contents would be written as.
fn refused_or_canonical(file: &[u8]) -> bool {
    read(file).map_or(true, |found| encode(&found.kind, found.generation, &found.sections, &go()).unwrap() == file)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(ProptestConfig::default().cases.max(2000)))]

    #[test]
    fn garbage_never_panics(bytes in proptest::collection::vec(any::<u8>(), 0..400), start in 0usize..500) {
        prop_assert!(read(&bytes).is_err());
        // with a good beginning and a correct digest, reading gets as far as possible
        let mut file = good();
        file.truncate(start);
        file.extend(bytes);
        file.resize(file.len().max(SEAL + ZEROS.len()), 0);
        prop_assert!(refused_or_canonical(&reseal(file)));
    }

    #[test]
    fn forged_files_are_refused_or_canonical(
        changes in proptest::collection::vec(
            (SEAL + ZEROS.len()..500, prop_oneof![
                Just(b'0'), Just(b'9'), Just(b'"'), Just(b','), Just(b' '), Just(b'}'), Just(b'['), any::<u8>()
            ]),
            1..6,
        )
    ) {
        let mut file = good();
        for (at, byte) in changes {
            let at = at % file.len();
            file[at.max(SEAL + ZEROS.len())] = byte;
        }
        prop_assert!(refused_or_canonical(&reseal(file)));
    }
}
