//! How a CSV file is written: what stands above its names, and what divides its cells.

use std::borrow::Cow;

use csv::{Reader, ReaderBuilder, StringRecord};

use super::cell::{is_value, shown};

/// What stands above the names.
pub(super) struct Head<'a> {
    pub(super) sep: u8,
    /// The byte at which the names begin.
    pub(super) at: usize,
    pub(super) comments: Vec<&'a str>,
}

/// The records of a text.
pub(super) fn rows(body: &str, sep: u8) -> Reader<&[u8]> {
    ReaderBuilder::new().delimiter(sep).has_headers(false).flexible(true).from_reader(body.as_bytes())
}

/// The number of ends of lines, of Unix, Windows or old Macs.
pub(super) fn count_lines(text: &str) -> usize {
    let count = |end: u8| text.bytes().filter(|&b| b == end).count();
    match count(b'\r') {
        0 => count(b'\n'),
        returns => count(b'\n') + returns - text.as_bytes().windows(2).filter(|pair| *pair == b"\r\n").count(),
    }
}

/// Where the line that begins at this byte ends, with what ends it.
fn line_end(text: &str, at: usize) -> usize {
    let end = text[at..].find(['\r', '\n']).map_or(text.len(), |end| at + end);
    end + if text[end..].starts_with("\r\n") { 2 } else { usize::from(end < text.len()) }
}

/// Lines to `skip`, empty lines, a line `sep=;`, and comments that begin with # or %.
pub(super) fn head(text: &str, skip: usize) -> Head<'_> {
    let mut head = Head { sep: b',', at: 0, comments: Vec::new() };
    for _ in 0..skip.min(text.len()) {
        head.at = line_end(text, head.at);
    }
    let mut sep = None;
    let first = text[..line_end(text, 0)].trim_end_matches(['\r', '\n', '"']).trim_start_matches('"');
    if let [b's' | b'S', b'e' | b'E', b'p' | b'P', b'=', one] = first.as_bytes()
        && skip == 0
        && one.is_ascii()
    {
        sep = Some(*one);
        head.at = line_end(text, 0);
    }
    while head.at < text.len() {
        let end = line_end(text, head.at);
        let line = text[head.at..end].trim_matches([' ', '\t', '\r', '\n', '"']);
        if !line.is_empty() && !line.starts_with(['#', '%']) {
            break;
        }
        if !line.is_empty() {
            head.comments.push(line.trim_matches([' ', '\t', ',', ';', '#', '%'])); // a spreadsheet adds commas
        }
        head.at = end;
    }
    head.sep = sep.unwrap_or_else(|| separator(&text[head.at..]));
    head
}

/// What divides the names and the first rows below into as many cells, most of them with values.
///
/// Blanks divide any row in which something is missing into wrong cells, so they are taken only where they find a
/// larger share of values than any mark.
fn separator(text: &str) -> u8 {
    let mut lines = text.split(['\r', '\n']).filter(|line| !line.trim().is_empty());
    let names = lines.next().unwrap_or_default();
    let (mut rows, mut best) = (Vec::new(), ((0.0, usize::MAX), None));
    rows.extend(lines.take(8));
    for sep in *b"\t;|, " {
        let count = filled(&cells(names, sep));
        let fit = |row: &StringRecord| count > 1 && (filled(row)..=row.len()).contains(&count);
        let share = |row: StringRecord| {
            let values = row.iter().filter(|cell| is_value(cell)).count();
            values as f64 / row.iter().filter(|cell| !cell.is_empty()).count().max(1) as f64
        };
        let shares = rows.iter().map(|row| cells(row, sep)).filter(fit).map(share).sum();
        let found = (shares, if sep == b' ' { 0 } else { count });
        if found > best.0 {
            best = (found, Some(sep));
        }
    }
    best.1.unwrap_or_else(|| *b"|\t;,".iter().max_by_key(|sep| cells(names, **sep).len()).unwrap_or(&b','))
}

/// The cells of a line.
fn cells(line: &str, sep: u8) -> StringRecord {
    let text = unified(line, sep);
    let mut record = StringRecord::new();
    // a line is text without errors of reading
    let _ = rows(&text, if sep == b' ' { b'\t' } else { sep }).read_record(&mut record);
    record.trim();
    record
}

/// The number of cells up to the last one that is not empty.
fn filled(record: &StringRecord) -> usize {
    record.iter().enumerate().filter(|(_, cell)| !cell.is_empty()).last().map_or(0, |(k, _)| k + 1)
}

/// The text with any number of blanks as one tab, if blanks divide cells; else without blanks before quotation marks
/// that open a cell.
pub(super) fn unified(text: &str, sep: u8) -> Cow<'_, str> {
    if sep != b' ' && !text.contains(" \"") {
        return Cow::Borrowed(text);
    }
    let (mut unified, mut at) = (String::new(), 0);
    while at < text.len() {
        let end = line_end(text, at);
        let line = text[at..end].trim_end_matches(['\r', '\n']);
        if sep == b' ' {
            for (k, cell) in line.split_whitespace().enumerate() {
                unified.push_str(if k == 0 { "" } else { "\t" });
                unified.push_str(cell);
            }
        } else {
            for (k, part) in line.split(char::from(sep)).enumerate() {
                if k > 0 {
                    unified.push(char::from(sep));
                }
                let bare = part.trim_start_matches(' ');
                unified.push_str(if bare.starts_with('"') { bare } else { part });
            }
        }
        unified.push_str(&text[at + line.len()..end]);
        at = end;
    }
    Cow::Owned(unified)
}

/// The names of the columns, and whether they stood in a comment, so that the first row is one of values.
pub(super) fn names(rows: &mut Reader<&[u8]>, head: &Head<'_>) -> Result<(Vec<String>, bool), String> {
    let mut row = StringRecord::new();
    rows.read_record(&mut row).map_err(|error| format!("must be a CSV file: {error}"))?;
    row.trim();
    row.truncate(filled(&row));
    if row.is_empty() {
        return Err("is empty: its first row must name the columns".into());
    }
    let mut values = row.iter().filter(|name| !name.is_empty());
    let counted = values.clone().enumerate().all(|(k, name)| *name == k.to_string()); // as pandas names columns
    if counted || !values.clone().all(is_value) {
        return Ok((owned(&row), false));
    }
    let above = head.comments.last().map(|line| cells(line, head.sep)).unwrap_or_default();
    if above.len() != row.len() || above.iter().any(|name| is_value(name) || name.contains('=')) {
        let found = shown(values.next().unwrap_or_default(), 30);
        return Err(format!(
            "must name its columns in the first row, got {found}: write names above it, or pass \
             pandas.read_csv(path, header=None) to from_table, whose columns are 0, 1, ..."
        ));
    }
    Ok((owned(&above), true))
}

fn owned(row: &StringRecord) -> Vec<String> {
    let mut names = Vec::new();
    row.iter().for_each(|name| names.push(name.to_string()));
    names
}
