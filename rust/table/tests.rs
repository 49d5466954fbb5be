use proptest::collection::vec;
use proptest::num::f64::{NORMAL, ZERO};
use proptest::{option, prelude::*};

use super::cell::{Comma, has_unit, is_number_with_comma, is_thousands, is_value, number};
use super::*;

fn read(text: &str) -> Result<Table> {
    Table::read("x.csv", text, 0)
}

fn fault(text: &str) -> String {
    read(text).map(|_| String::new()).unwrap_or_else(|error| error.to_string())
}

#[test]
fn the_separator_is_the_one_that_divides_names_and_values_alike() {
    for text in
        ["a,b\n1,2\n3,\n", "a;b\n1;2\n3;\n", "a\tb\r\n1\t2\r\n3\t\r\n", "a b\n1  2\n3 nan", "sep=|\na|b\n1|2\n3|"]
    {
        let table = read(text).unwrap();
        assert_eq!(table.names, ["a", "b"]);
        let [a, b] = [0, 1].map(|k| table.numbers(k, false).unwrap());
        assert!(a == [1.0, 3.0] && b[0] == 2.0 && b[1].is_nan(), "{text:?}");
    }
    // a missing word of two words beside an empty cell: as many blanks as tabs
    for text in ["a\tb\tc\n0\t\t#N/A N/A\n0\t#N/A N/A\t\n0\t1\t#N/A N/A\n", "a\tb c\n\n1\t2  3\n"] {
        assert_eq!(read(text).unwrap().names, ["a", "b", "c"], "{text:?}");
    }
    let table = read("a;b\n1,5;2\n2;,5\n").unwrap();
    assert_eq!(table.numbers(0, true).unwrap(), [1.5, 2.0]);
    assert_eq!(read("a\tb\n1,5\t2\n2\t-,5\n").unwrap().numbers(1, true).unwrap(), [2.0, -0.5]);
    assert_eq!(read("a b\n1,5 2\n2 0,123\n").unwrap().numbers(1, true).unwrap(), [2.0, 0.123]);
    // thousands or decimals: not known; labels with a comma beside numbers with a point
    assert!(read("a\tb\n1,234\t2\n").unwrap().numbers(0, false).unwrap_err().to_string().contains("as 1,234"));
    let labelled = read("a\tb\n1,2\t2.5\n").unwrap();
    assert_eq!((labelled.numbers(1, true).unwrap()[0], labelled.column(0).next()), (2.5, Some("1,2")));
    assert_eq!(read("a, \"b, c\"\n1, \"2\"\n3,4\n").unwrap().names, ["a", "b, c"]);
}

#[test]
fn rows_know_the_lines_where_they_begin() {
    for end in ["\n", "\r\n", "\r"] {
        let text = ["# from a rig", "", "a,\"b\"", "", "1,\"2", "\"", "", "3,4", "5,6", ",", ""].join(end);
        let table = read(&text).unwrap();
        assert_eq!((0..table.rows()).map(|row| table.line(row)).collect::<Vec<_>>(), [5, 8, 9]);
        assert!(fault(&text.replace("5,6", "5,6,7")).contains("has 3 cells, not 2, in line 9"));
    }
    assert!(fault("a,b\n1,2\n\"3,4\n5,6\n7,8").contains("line 3: a quotation mark is open"));
    assert!(fault("a,b\n1,2\n\n#3,4\n5,6").contains("a comment among its rows, in line 4"));
    assert_eq!(read("a,b\n#1,2\n#2,3").unwrap().column(0).collect::<Vec<_>>(), ["#1", "#2"]);
}

#[test]
fn a_row_of_units_is_no_row_of_values() {
    let table = read("t,p [m],v\ns,mm,(m/s)\n0,1,2\n1,,3\n").unwrap();
    assert_eq!(table.names, ["t [s]", "p [m]", "v [m/s]"]);
    assert_eq!((table.rows(), table.line(0)), (2, 3));
    assert_eq!(table.numbers(2, true).unwrap(), [2.0, 3.0]);
    assert!(table.numbers(1, true).unwrap_err().to_string().contains("column 'p [m]', got '' in line 4"));
    let names = ["a [b]", "a(b)", "a (rad)", "x[0]", "x(-1)", "[b]", "a", "a[]", "a]"].map(has_unit);
    assert_eq!(names, [true, true, true, false, false, false, false, false, false]);
}

#[test]
fn numbers_are_told_from_words_and_dates() {
    let values = ["1", "-1.5e3", "+,5", "1,", "nan", "-inf", "NA", "#N/A", "2024-03-05", "10:00:00", "1.2.3"];
    assert!(values.into_iter().all(is_value));
    assert!(!["", "a", "1-2", "1_5", "1,2,3", "1.5,2", "e5", "-", "--"].into_iter().any(is_value));
    assert_eq!(number("1.0", Comma::Decimal), None);
    assert_eq!(number("-1,5e1", Comma::Decimal), Some(-15.0));
    assert_eq!(number("1,5", Comma::None), None);
    assert!(["1,234", "-12,345", "1,234,567"].into_iter().all(is_thousands));
    assert!(!["0,234", "1,23", "1234,567", "1,5e3", ",234", "1,2345"].into_iter().any(is_thousands));
}

/// What stands for a missing number, in `pandas.read_csv` and in the files of loggers.
const MISSING: [&str; 23] = [
    "", "NA", "N/A", "n/a", "NULL", "null", "None", "NaN", "nan", "-NaN", "-nan", "#N/A", "#N/A N/A", "#NA", "<NA>",
    "1.#IND", "-1.#IND", "1.#QNAN", "-1.#QNAN", "-", "--", "---", " ",
];

#[test]
fn words_and_dashes_for_a_missing_number() {
    for word in MISSING {
        let table = read(&format!("a,b\n1,2\n{word},{word}\n3,4\n")).unwrap();
        for (column, [first, last]) in [(0, [1.0, 3.0]), (1, [2.0, 4.0])] {
            let found = table.numbers(column, false).unwrap();
            assert!(found[0] == first && found[1].is_nan() && found[2] == last, "{word:?}");
        }
    }
    for word in ["----", "#", "?", "missing", "-1.#", "#VALUE!"] {
        assert!(read(&format!("a,b\n1,2\n3,{word}\n")).unwrap().numbers(1, false).is_err(), "{word}");
    }
    // a dash is a unit as well
    assert_eq!(read("t,r\ns,-\n0,1\n1,-\n").unwrap().names, ["t [s]", "r [-]"]);
}

proptest! {
    /// What is written is read, to the last bit, or refused where it may be read in two ways.
    #[test]
    fn no_number_is_lost(
        rows in vec((any_number(), option::of(any_number()), option::of(-2_000_000i32..2_000_000)), 1..8),
        sep in prop::sample::select(vec![',', ';', '\t', '|']),
        (comma, exponents) in (any::<bool>(), any::<bool>()),
        words in vec(prop::sample::select(MISSING.to_vec()), 16),
    ) {
        let comma = comma && sep != ',';
        let shown = |v: f64| {
            let text = if exponents { format!("{v:e}") } else { v.to_string() };
            if comma { text.replace('.', ",") } else { text }
        };
        let mut words = words.into_iter();
        let mut cell = |v: Option<f64>| v.map_or_else(|| words.next().unwrap().to_string(), shown);
        let mut text = format!("a{sep}b{sep}c");
        let mut cells = Vec::new();
        for (a, b, c) in &rows {
            let row = [Some(*a), *b, c.map(f64::from)].map(&mut cell);
            text += &format!("\n{}", row.join(&sep.to_string()));
            cells.extend(row);
        }
        // one of 1.#IND beside decimal commas is a word, no number with a point
        let with_comma = || cells.iter().filter(|cell| cell.contains(',') && is_number_with_comma(cell));
        let doubtful = comma && sep != ';' && with_comma().count() > 0 && with_comma().all(|cell| is_thousands(cell));
        let table = read(&text).unwrap();
        let columns = [0, 1, 2].map(|k| table.numbers(k, false));
        prop_assert_eq!(columns.iter().all(|column| column.is_ok()), !doubtful, "{}", text);
        for (k, column) in columns.into_iter().enumerate() {
            let Ok(column) = column else { continue };
            for (found, (a, b, c)) in column.into_iter().zip(&rows) {
                let written = [Some(*a), *b, c.map(f64::from)][k];
                prop_assert!(written.map_or(found.is_nan(), |v| v == found), "{found} in {text}");
            }
        }
    }
}

fn any_number() -> impl Strategy<Value = f64> {
    prop_oneof![NORMAL | ZERO, -1e4..1e4, (-5000i32..5000).prop_map(|v| f64::from(v) / 1000.0)]
}

#[test]
fn dates_are_seconds_since_the_first_with_their_zones() {
    let seconds = |cells: &[&str]| instants(cells.iter().copied()).unwrap();
    assert_eq!(seconds(&["2024-02-28 23:59:59.75", "2024-03-01T00:00:00", "2024-03"]).0, [0.0, 86_400.25, 86_400.25]);
    let zones =
        ["2024-05-01T02:00:00+02:00", "2024-05-01 00:00:01Z", "2024-05-01 00:00:02 utc", "2024-04-30 19:00:03-05"];
    assert_eq!(seconds(&zones), (Vec::from([0.0, 1.0, 2.0, 3.0]), None));
    assert_eq!(seconds(&["2024-05-01 00:00Z", "2024-05-01 00:01"]).1, Some(1));
    assert!(seconds(&["2024-05-01", "", "2024-05-02"]).0[1].is_nan());
    for wrong in
        ["now", "03/05/2024", "2023-02-29", "2024-13-01", "2024-01-01 24:00", "2024-01-01 10:00 CET", "2024-01-01 1"]
    {
        assert_eq!(seconds(&[wrong]).1, Some(0), "{wrong}");
    }
}
