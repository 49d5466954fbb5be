//! Fractional parts of expected counts, in whole numbers of any size: what systematic samples vary by.

use std::iter::repeat;

use crate::error::{Error, Result};
use crate::memory::{try_copy, try_filled, try_room, try_zeros};

const WHAT: &str = "the fractional parts";

/// `f = frac(N |w_i| / g)` and `1 - f`, or those of `N (|w_1| + ... + |w_i|) / g`: each correct to its last digits, and
/// 0 exactly where it is 0.
pub(super) fn fractions(w: &[f64], size: u64, summed: bool) -> Result<Vec<(f64, f64)>> {
    if size > 1 << 53 {
        return Err(Error::Value { name: "size", expected: "at most 2^53", found: size.to_string() });
    }
    if w.iter().all(|v| *v == 0.0) {
        return try_filled(WHAT, (0.0, 1.0), w.len());
    }
    let exponents = || w.iter().filter(|v| **v != 0.0).map(|v| split(*v).1);
    let (least, most) = (exponents().min().unwrap_or(0), exponents().max().unwrap_or(0));
    // 53 bits of an entry, 64 each for the number of entries and for N, and the sign
    let limbs = (most - least) as usize / 64 + 4;
    let (mut whole, mut part, mut rest): (Vec<u64>, Vec<u64>, Vec<u64>) =
        (try_zeros(WHAT, limbs)?, try_zeros(WHAT, limbs)?, try_zeros(WHAT, limbs)?);
    w.iter().for_each(|v| add_double(&mut whole, *v, least));
    let (mut left, mut found) = (try_copy(WHAT, &whole)?, try_room(WHAT, w.len())?);
    for v in w {
        if !summed {
            part.fill(0);
        }
        add_double(&mut part, *v, least);
        // the quotient of N part and whole, a few off at most
        let quotient = (size as f64 * ratio(&part, &whole)) as i128;
        rest.fill(0);
        add_product(&mut rest, &part, i128::from(size));
        add_product(&mut rest, &whole, -quotient);
        while rest[limbs - 1] >> 63 == 1 {
            add_product(&mut rest, &whole, 1);
        }
        while whole.iter().rev().le(rest.iter().rev()) {
            add_product(&mut rest, &whole, -1);
        }
        left.copy_from_slice(&whole);
        add_product(&mut left, &rest, -1);
        found.push((ratio(&rest, &whole), ratio(&left, &whole)));
    }
    Ok(found)
}

/// `|v| = mantissa 2^exponent`
fn split(v: f64) -> (u64, i32) {
    let (mantissa, exponent) = (v.to_bits() & ((1 << 52) - 1), (v.to_bits() >> 52 & 0x7ff) as i32);
    if exponent == 0 { (mantissa, -1074) } else { (mantissa | 1 << 52, exponent - 1075) }
}

/// Adds `|v| 2^-least`.
fn add_double(to: &mut [u64], v: f64, least: i32) {
    if v != 0.0 {
        let (mantissa, exponent) = split(v);
        let shift = (exponent - least) as usize;
        add_product(&mut to[shift / 64..], &[mantissa], 1 << (shift % 64));
    }
}

/// Adds `by` times a number, both in two's complement; `|by| <= 2^63`.
fn add_product(to: &mut [u64], of: &[u64], by: i128) {
    let mut carry = 0;
    for (to, of) in to.iter_mut().zip(of.iter().chain(repeat(&0))) {
        let total = i128::from(*to) + i128::from(*of) * by + carry;
        (*to, carry) = (total as u64, total >> 64);
    }
}

/// The quotient of two numbers, rounded three times; 0 of nothing.
fn ratio(part: &[u64], whole: &[u64]) -> f64 {
    let leading = |of: &[u64]| {
        let top = of.iter().rposition(|limb| *limb != 0)?;
        let below = if top > 0 { of[top - 1] } else { 0 };
        Some(((u128::from(of[top]) << 64 | u128::from(below)) as f64, top))
    };
    let (Some((part, low)), Some((whole, high))) = (leading(part), leading(whole)) else { return 0.0 };
    (low..high).fold(part / whole, |ratio, _| ratio * 2f64.powi(-64))
}
