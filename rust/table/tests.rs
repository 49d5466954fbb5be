use super::cell::{Comma, has_unit, is_value, number};
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
    let table = read("a;b\n1,5;2\n2;,5\n").unwrap();
    assert_eq!(table.numbers(0, true).unwrap(), [1.5, 2.0]);
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
    let values = ["1", "-1.5e3", "+,5", "1,", "nan", "-inf", "NA", "2024-03-05", "10:00:00", "1.2.3"];
    assert!(values.into_iter().all(is_value));
    assert!(!["", "a", "1-2", "1_5", "1,2,3", "1.5,2", "e5", "-"].into_iter().any(is_value));
    assert_eq!(number("1.0", Comma::Decimal), None);
    assert_eq!(number("-1,5e1", Comma::Decimal), Some(-15.0));
    assert_eq!(number("1,5", Comma::None), None);
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
