//! Cells of text: numbers, what stands for a missing one, and names with units.

/// What a comma is in a number.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Comma {
    None,
    Decimal,
    /// Or a point.
    Either,
}

/// The number that a cell is.
pub(super) fn number(cell: &str, comma: Comma) -> Option<f64> {
    if comma == Comma::None || !cell.contains(',') {
        return if comma == Comma::Decimal && cell.contains('.') { None } else { cell.parse().ok() };
    }
    if cell.contains('.') { None } else { cell.replace(',', ".").parse().ok() }
}

/// Words for a missing number beside nan, in any case: those of `pandas.read_csv`.
const WORDS: [&str; 12] =
    ["NA", "N/A", "null", "None", "#N/A", "#N/A N/A", "#NA", "<NA>", "1.#IND", "-1.#IND", "1.#QNAN", "-1.#QNAN"];

/// Dashes are for a missing number, too; in a row of units for one without.
const DASHES: [&str; 3] = ["-", "--", "---"];

fn is_word(cell: &str) -> bool {
    WORDS.iter().any(|word| word.eq_ignore_ascii_case(cell))
}

pub(super) fn is_missing(cell: &str) -> bool {
    cell.is_empty() || is_word(cell) || DASHES.contains(&cell)
}

/// Whether a cell is a number in either notation, stands for a missing one, or begins as a date or a time does.
pub(super) fn is_value(cell: &str) -> bool {
    let digits = |text: &str| text.bytes().take_while(u8::is_ascii_digit).count();
    // as `2024-03-05` and `10:00:00`: digits, a mark, digits, a mark, a digit
    let behind = |text: &'_ str| match digits(text) {
        0 => None,
        count => text[count..].strip_prefix(['-', '/', '.', ':']).map(|rest| text.len() - rest.len()),
    };
    let date = behind(cell).is_some_and(|at| {
        behind(&cell[at..]).is_some_and(|more| cell[at + more..].starts_with(|c: char| c.is_ascii_digit()))
    });
    !cell.is_empty() && (date || is_word(cell) || number(cell, Comma::Either).is_some())
}

pub(super) fn is_number_with_comma(cell: &str) -> bool {
    cell.contains(',') && !cell.ends_with(',') && number(cell, Comma::Decimal).is_some()
}

/// Whether a comma may divide thousands, as in `1,234`.
pub(super) fn is_thousands(cell: &str) -> bool {
    let mut groups = cell.trim_start_matches(['-', '+']).split(',');
    let digits = |group: &str| group.bytes().all(|b| b.is_ascii_digit());
    let first =
        groups.next().is_some_and(|first| (1..=3).contains(&first.len()) && !first.starts_with('0') && digits(first));
    first && groups.all(|group| group.len() == 3 && digits(group))
}

/// Whether a name has a unit behind it, as in `angle [rad]` and `angle(rad)`; but `x[0]` is a name.
pub(super) fn has_unit(name: &str) -> bool {
    let inner = name.strip_suffix([']', ')']).and_then(|name| name.rsplit_once(['[', '(']));
    inner.is_some_and(|(before, unit)| {
        let number = unit.trim_start().trim_start_matches(['-', '+']).starts_with(|c: char| c.is_ascii_digit());
        !before.trim().is_empty() && !unit.is_empty() && !number && !unit.contains([']', ')'])
    })
}

/// A text in quotes on one line, at most so many characters of it.
pub(super) fn shown(text: &str, most: usize) -> String {
    let mut shown = String::from("'");
    for one in text.chars().take(most) {
        if matches!(one, '\'' | '"') { shown.push(one) } else { shown.extend(one.escape_debug()) }
    }
    shown + "'"
}
