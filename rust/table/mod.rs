//! Tables in CSV files, as loggers and spreadsheets write them: what divides the cells, where the names stand, which
//! rows are none; and the numbers and times in the cells.

mod cell;
mod layout;
mod pieces;
mod time;

use std::ops::Range;

use csv::{Reader, StringRecord};

pub use pieces::Pieces;
pub use time::instants;

use crate::error::{Error, Result};
use crate::memory::{covered, try_collect, try_collect_all, try_push};
use cell::{Comma, has_unit, is_missing, is_number_with_comma, is_thousands, is_value, number, shown};

/// Bytes of the buffers of a CSV reader.
const READER: u128 = 1 << 14;
const WHAT: &str = "a table";
/// Rows up to which one of another length says that the names stand further down.
const FIRST: usize = 5;

/// The cells below the names of their columns, without blanks around them.
#[derive(Debug)]
pub struct Table {
    path: String,
    /// The columns, with units behind their names where a row of units stands below.
    pub names: Vec<String>,
    comma: bool,
    cells: String,
    ends: Vec<usize>,
    /// The line of the file in which each row begins, from 1.
    lines: Vec<usize>,
}

impl Table {
    /// Reads the text of the file `path`, whose name is for messages, but for the first lines.
    ///
    /// # Errors
    /// [`Error::File`] if the text is no table; [`Error::Memory`].
    pub fn read(path: &str, text: &str, skip: usize) -> Result<Self> {
        covered(WHAT, READER + 24 * text.len() as u128, || Self::of_text(path, text, skip))?
    }

    fn of_text(path: &str, text: &str, skip: usize) -> Result<Self> {
        let refuse = |fault: String| Error::File { path: path.into(), fault };
        let head = layout::head(text, skip);
        let body = layout::unified(&text[head.at..], head.sep);
        let sep = if head.sep == b' ' { b'\t' } else { head.sep };
        let mut reader = layout::rows(&body, sep);
        let (names, again) = layout::names(&mut reader, &head).map_err(refuse)?;
        if again {
            reader = layout::rows(&body, sep);
        }
        let mut table =
            Self { path: path.into(), names, comma: false, cells: String::new(), ends: Vec::new(), lines: Vec::new() };
        table
            .cells
            .try_reserve_exact(body.len())
            .map_err(|_| Error::Memory { what: WHAT, bytes: body.len() as u128 })?;
        let above = 1 + layout::count_lines(&text[..head.at]);
        table.fill(reader, &body, above, sep)?;
        table.take_units()?;
        let mut sorted = try_collect(WHAT, table.names.iter().map(String::as_str))?;
        sorted.sort_unstable();
        if let Some(pair) = sorted.windows(2).find(|pair| pair[0] == pair[1]) {
            return Err(refuse(format!("has the column {} twice", shown(pair[0], 40))));
        }
        if table.lines.is_empty() {
            return Err(refuse("has no rows below the names of its columns".into()));
        }
        table.comma = table.has_decimal_commas(sep);
        Ok(table)
    }

    /// Whether commas are decimal ones. Behind `;` they are; between tabs they may divide thousands, as English
    /// spreadsheets write them: there one must be decimal for sure, and no number have a point.
    fn has_decimal_commas(&self, sep: u8) -> bool {
        let cells = || (0..self.ends.len()).map(|k| self.cell(k));
        let sure = |cell: &str| is_number_with_comma(cell) && !is_thousands(cell);
        let point = |cell: &str| cell.contains('.') && number(cell, Comma::None).is_some();
        match sep {
            b',' => false,
            b';' => cells().any(is_number_with_comma),
            _ => cells().any(sure) && !cells().any(point),
        }
    }

    /// Takes the rows below the names, all of their number of cells.
    fn fill(&mut self, mut rows: Reader<&[u8]>, body: &str, above: usize, sep: u8) -> Result<()> {
        let (mut record, mut line, mut from) = (StringRecord::new(), above, 0);
        let (mut comments, mut first_comment, width) = (0, 0, self.names.len());
        loop {
            let start = rows.position().byte() as usize;
            let start = start + body[start..].bytes().take_while(|b| matches!(b, b'\r' | b'\n')).count();
            if !rows.read_record(&mut record).map_err(|error| self.refusal(format!("must be a CSV file: {error}")))? {
                break;
            }
            line += layout::count_lines(&body[from..start]);
            from = start;
            if record.len() != width {
                let beyond = record.iter().skip(width).all(|cell| cell.trim().is_empty());
                if record.len() < width && record.iter().all(|cell| cell.trim().is_empty()) {
                    continue;
                }
                if is_comment(&record) {
                    return Err(self.comment(line));
                }
                if record.len() < width || !beyond {
                    let cure = ragged(&record, width, sep, self.lines.len() < FIRST);
                    let found = record.len();
                    return Err(self.refusal(format!("has {found} cells, not {width}, in line {line}{cure}")));
                }
            }
            if is_comment(&record) {
                comments += 1;
                first_comment = if comments == 1 { line } else { first_comment };
            }
            for cell in record.iter().take(width) {
                self.cells.push_str(cell.trim());
                try_push(WHAT, &mut self.ends, self.cells.len())?;
            }
            try_push(WHAT, &mut self.lines, line)?;
        }
        while !self.lines.is_empty() && self.row(self.lines.len() - 1).all(|k| self.cell(k).is_empty()) {
            self.lines.pop(); // as a spreadsheet leaves them
            self.ends.truncate(self.lines.len() * width);
        }
        // all of them are labels that begin so
        if 0 < comments && comments < self.lines.len() { Err(self.comment(first_comment)) } else { Ok(()) }
    }

    /// Makes a first row of text above numbers part of the names.
    fn take_units(&mut self) -> Result<()> {
        let width = self.names.len();
        let unit = |k: usize| self.cell(k).trim_matches([' ', '[', ']', '(', ')']);
        let above = |k: usize| !self.cell(k).is_empty() && is_value(self.cell(k + width));
        if self.lines.len() < 2 || self.row(0).any(|k| is_value(self.cell(k))) || !self.row(0).any(above) {
            return Ok(());
        }
        let titled = self.names.iter().enumerate().map(|(k, name)| match unit(k) {
            unit if unit.is_empty() || has_unit(name) => Ok(name.clone()),
            unit => Ok(format!("{name} [{unit}]")),
        });
        self.names = try_collect_all(WHAT, titled)?;
        self.ends.drain(..width - 1); // the last one stays: the next row begins there
        self.cells.drain(..self.ends[0]);
        let before = self.ends.remove(0);
        self.ends.iter_mut().for_each(|end| *end -= before);
        self.lines.remove(0);
        Ok(())
    }

    /// The places of the cells of a row.
    fn row(&self, row: usize) -> Range<usize> {
        row * self.names.len()..(row + 1) * self.names.len()
    }

    fn cell(&self, k: usize) -> &str {
        &self.cells[if k == 0 { 0 } else { self.ends[k - 1] }..self.ends[k]]
    }

    /// The number of rows.
    #[must_use]
    pub fn rows(&self) -> usize {
        self.lines.len()
    }

    /// The line of the file in which a row begins, from 1.
    #[must_use]
    pub fn line(&self, row: usize) -> usize {
        self.lines[row]
    }

    /// The cells of a column.
    pub fn column(&self, column: usize) -> impl Iterator<Item = &str> {
        (0..self.rows()).map(move |row| self.cell(row * self.names.len() + column))
    }

    /// A column of numbers; NaN where one is missing, unless the column must be `whole`.
    ///
    /// # Errors
    /// [`Error::File`] with the first cell that is no number; [`Error::Memory`].
    pub fn numbers(&self, column: usize, whole: bool) -> Result<Vec<f64>> {
        let comma = if self.comma { Comma::Decimal } else { Comma::None };
        let values = self.column(column).enumerate().map(|(row, cell)| match number(cell, comma) {
            Some(value) => Ok(value),
            None if !whole && is_missing(cell) => Ok(f64::NAN),
            None => {
                let (name, line) = (shown(&self.names[column], 30), self.lines[row]);
                let (found, cure) = (shown(cell, 30), self.cure(column, cell));
                Err(self.refusal(format!("must have numbers in column {name}, got {found} in line {line}{cure}")))
            }
        });
        try_collect_all("a column of a table", values)
    }

    /// What to do about a cell that is no number, or no time.
    #[must_use]
    pub fn cure(&self, column: usize, cell: &str) -> &'static str {
        let behind = self.names[column].strip_prefix(cell).filter(|_| !cell.is_empty()).map(str::trim_start);
        if behind.is_some_and(|unit| unit.is_empty() || unit.starts_with(['[', '('])) {
            ", the names of the columns again: split the file there, or fill a column that tells runs apart for `by`"
        } else if self.comma && cell.contains('.') {
            ", where others have a decimal comma: write all numbers alike"
        } else if !self.comma && is_number_with_comma(cell) {
            ": decimal commas are read where ; or a tab stands between the cells, if no number has a point, and not all \
             may be thousands as 1,234"
        } else {
            ""
        }
    }

    fn refusal(&self, fault: String) -> Error {
        Error::File { path: self.path.clone(), fault }
    }

    fn comment(&self, line: usize) -> Error {
        self.refusal(format!(
            "has a comment among its rows, in line {line}: delete it; of a row that was lost leave the stamp, and empty \
             cells"
        ))
    }
}

fn is_comment(record: &StringRecord) -> bool {
    record.get(0).is_some_and(|cell| cell.trim_start().starts_with(['#', '%']) && !is_missing(cell.trim()))
}

/// What to do about a row with more or fewer cells than there are names.
fn ragged(record: &StringRecord, width: usize, sep: u8, first: bool) -> &'static str {
    if sep == b',' && record.len() == 2 * width && record.iter().all(|cell| is_value(cell.trim())) {
        ": decimal commas between commas cannot be read: save it with ; between the cells"
    } else if record.iter().any(|cell| cell.contains(['\n', '\r'])) {
        ": a quotation mark is open there, close it or delete it"
    } else if first {
        ": if the names of its columns stand further down, pass `skip`, the lines above them"
    } else {
        ": complete the row with empty cells, or delete it if it is none"
    }
}

#[cfg(test)]
mod tests;
