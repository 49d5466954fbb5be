//! Tests of the container in memory, and of files on a failing disk.

mod file;
mod format;

pub(super) use file::disk_point;

use super::{Container, Section, Values};
use crate::Stop;

/// A state with all element types, an empty section, and values whose bits are easily lost.
fn example() -> Vec<Section<'static>> {
    let values = [0.1, -0.0, f64::from_bits(1), f64::MAX, f64::from_bits(0x7ff8_dead_beef_0001)];
    vec![
        section("reals", Values::Reals(values.to_vec().into())),
        section("count", Values::Integers(vec![u64::MAX, 0, 1 << 53].into())),
        section("note", Values::Bytes(b"abc".to_vec().into())),
        section("nothing", Values::Reals(Vec::new().into())),
    ]
}

fn section(name: &str, values: Values<'static>) -> Section<'static> {
    Section { name: name.to_owned().into(), values }
}

fn reals<'a>(container: &'a Container, name: &str) -> &'a [f64] {
    match container.values(name) {
        Some(Values::Reals(values)) => values,
        other => panic!("{other:?}"),
    }
}

fn go() -> Stop {
    Stop::new()
}
