//! Dates and times as in ISO 8601, with time zones or without.

use super::cell::is_missing;
use crate::error::Result;
use crate::memory::try_push;

const SECOND: i128 = 1_000_000_000;

/// Dates and times in seconds since the first cell, NaN where one is missing; and the first cell that is neither, or
/// has a time zone where others have none.
///
/// # Errors
/// [`crate::Error::Memory`].
pub fn instants<'a>(cells: impl Iterator<Item = &'a str>) -> Result<(Vec<f64>, Option<usize>)> {
    let (mut seconds, mut first, mut zoned) = (Vec::new(), None, None);
    for (k, cell) in cells.map(str::trim).enumerate() {
        let found = if is_missing(cell) { None } else { instant(cell) };
        let same = found.is_none_or(|(_, zone)| *zoned.get_or_insert(zone) == zone);
        if !same || (found.is_none() && !is_missing(cell)) {
            return Ok((seconds, Some(k)));
        }
        let time = found.map(|(time, _)| time);
        let begin = *first.get_or_insert(time);
        let since = begin.zip(time).map_or(f64::NAN, |(begin, time)| (time - begin) as f64 / SECOND as f64);
        try_push("times", &mut seconds, since)?;
    }
    Ok((seconds, None))
}

/// Nanoseconds since 1970, and whether they are of UTC: `2024-03-05T10:00:00.5+01:00`, or less of it.
fn instant(text: &str) -> Option<(i128, bool)> {
    let (local, ahead) = zone(text);
    let mut rest = local;
    let mut part = |before: &[char], digits: usize| {
        if rest.is_empty() {
            return Some(None);
        }
        let text = if before.is_empty() { rest } else { rest.strip_prefix(before)? };
        let (number, more) = text.split_at_checked(digits)?;
        rest = more;
        if number.bytes().all(|b| b.is_ascii_digit()) { Some(number.parse::<i64>().ok()) } else { None }
    };
    let (year, month) = (part(&[], 4)??, part(&['-'], 2)??);
    let (day, hour) = (part(&['-'], 2)?, part(&['T', 't', ' '], 2)?);
    let (minute, second) = (part(&[':'], 2)?, part(&[':'], 2)?);
    let fraction = match rest.strip_prefix(['.', ',']) {
        None if rest.is_empty() => 0,
        Some(digits) if second.is_some() && !digits.is_empty() && digits.bytes().all(|b| b.is_ascii_digit()) => {
            format!("{digits:0<9}")[..9].parse().ok()?
        }
        _ => return None,
    };
    let (hour, minute, second) = (hour.unwrap_or(0), minute.unwrap_or(0), second.unwrap_or(0));
    let leap = year % 4 == 0 && (year % 100 != 0 || year % 400 == 0);
    let days = match month {
        2 => 28 + i64::from(leap),
        4 | 6 | 9 | 11 => 30,
        _ => 31,
    };
    let day = day.unwrap_or(1);
    if !(1..=12).contains(&month) || !(1..=days).contains(&day) || hour > 23 || minute > 59 || second > 59 {
        return None;
    }
    // days since 1970 in the Gregorian calendar, with years that begin in March
    let (year, month) = if month > 2 { (year, month - 3) } else { (year - 1, month + 9) };
    let days = 365 * year + year.div_euclid(4) - year.div_euclid(100) + year.div_euclid(400) + (153 * month + 2) / 5;
    let seconds = (days + day - 1 - 719_468) * 86_400 + hour * 3600 + minute * 60 + second - ahead.unwrap_or(0);
    Some((i128::from(seconds) * SECOND + fraction, ahead.is_some()))
}

/// A time without its zone, and the seconds that this is ahead of UTC: Z, UTC, +01, +0100, +01:00.
fn zone(text: &str) -> (&str, Option<i64>) {
    let Some(colon) = text.find(':') else { return (text, None) };
    for utc in ["Z", "UTC"] {
        if let Some((local, end)) = text.len().checked_sub(utc.len()).and_then(|at| text.split_at_checked(at))
            && end.eq_ignore_ascii_case(utc)
        {
            return (local.trim_end(), Some(0));
        }
    }
    let sign = text[colon..].rfind(['+', '-']).map(|sign| colon + sign);
    let Some((local, offset)) = sign.map(|sign| text.split_at(sign)) else { return (text, None) };
    let digits = offset[1..].replacen(':', "", usize::from(offset.as_bytes().get(3) == Some(&b':')));
    if !matches!(digits.len(), 2 | 4) || !digits.bytes().all(|b| b.is_ascii_digit()) {
        return (text, None);
    }
    let number = |part: &str| part.parse::<i64>().unwrap_or(0);
    let ahead = 3600 * number(&digits[..2]) + 60 * number(&digits[2..]);
    (local.trim_end(), Some(if offset.starts_with('-') { -ahead } else { ahead }))
}
