use super::*;

/// `y = Theta z + w` by integer formulas: rows `(z, y)` of 12 pairs with `d = 3`, `n = 2`.
pub(crate) fn pairs() -> Vec<f64> {
    let theta = [[0.9, 0.2, 0.0], [-0.1, 0.8, 1.0]];
    let mut rows = Vec::new();
    for t in 0..12i64 {
        let z: [f64; 3] = std::array::from_fn(|i| (((2 * i as i64 + 1) * (t + 1).pow(2)) % 11 - 5) as f64);
        rows.extend(z);
        for (i, row) in theta.iter().enumerate() {
            let w = (((i as i64 + 3) * (t + 2).pow(2)) % 13 - 6) as f64 / 20.0;
            rows.push(row.iter().zip(z).map(|(a, b)| a * b).sum::<f64>() + w);
        }
    }
    rows
}

fn gram(r: &[f64], k: usize) -> Vec<f64> {
    let mut g = vec![0.0; k * k];
    for row in r.chunks(k) {
        for (i, a) in row.iter().enumerate() {
            row.iter().enumerate().for_each(|(j, b)| g[i * k + j] += a * b);
        }
    }
    g
}

#[test]
fn the_triangle_of_the_data_set() {
    let (rows, stop) = (pairs(), Stop::new());
    let r = triangle(&rows, 5, 1, &stop).unwrap();
    let v = gram(&r, 5);
    let expected = [115.0, 41.0, -11.0, 103.0, -11.0, 99.0];
    for (found, expected) in [v[0], v[1], v[2], v[6], v[7], v[12]].iter().zip(expected) {
        assert!((found - expected).abs() < 1e-12);
    }
    // R22' R22 = S
    let s = [r[18] * r[18], r[18] * r[19], r[19] * r[19] + r[24] * r[24]];
    for (found, expected) in s.iter().zip([0.453161369193, 0.042660146699, 0.062427872861]) {
        assert!((found - expected).abs() < 1e-12);
    }
    assert!((0..5).all(|i| r[6 * i] > 0.0 && r[5 * i..6 * i].iter().all(|&v| v == 0.0)));
    let mut grown = vec![0.0; 25];
    rows.chunks(5).for_each(|row| update(&mut grown, row, 5, &stop).unwrap());
    assert!(r.iter().zip(&grown).all(|(a, b)| (a - b).abs() < 1e-13));
}

#[test]
fn threads_change_no_bit_and_powers_of_two_only_the_scale() {
    let (k, stop) = (7, Stop::new());
    let mut word = 1u64;
    let mut next = || {
        word = word.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (word >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    };
    let rows: Vec<f64> = (0..k * (2 * CHUNK + 77)).map(|_| next()).collect();
    let one = triangle(&rows, k, 1, &stop).unwrap();
    assert_eq!(one, triangle(&rows, k, 3, &stop).unwrap());
    for (a, b) in gram(&one, k).iter().zip(gram(&rows, k)) {
        assert!((a - b).abs() < 1e-9);
    }
    for scale in [2f64.powi(-900), 2f64.powi(900)] {
        let scaled: Vec<f64> = rows[..700].iter().map(|v| v * scale).collect();
        let back: Vec<f64> = triangle(&scaled, k, 1, &stop).unwrap().iter().map(|v| v / scale).collect();
        for (a, b) in back.iter().zip(triangle(&rows[..700], k, 1, &stop).unwrap()) {
            assert!((a - b).abs() < 1e-13);
        }
    }
}

#[test]
fn few_rows_none_and_bad_ones() {
    let stop = Stop::new();
    assert_eq!(triangle(&[], 2, 1, &stop).unwrap(), [0.0; 4]);
    assert_eq!(triangle(&[3.0, 0.0, -4.0, 0.0], 2, 1, &stop).unwrap(), [5.0, 0.0, 0.0, 0.0]);
    assert!(matches!(triangle(&[1.0, f64::NAN], 2, 1, &stop), Err(Error::NonFinite { index: 1, .. })));
    assert!(matches!(triangle(&[1.0; 3], 2, 1, &stop), Err(Error::Shape { .. })));
    assert!(matches!(triangle(&[1e308; 9], 1, 1, &stop), Err(Error::Overflow { .. })));
    let asked = Stop::new();
    asked.request();
    assert_eq!(triangle(&[1.0], 1, 1, &asked), Err(Error::Interrupted));
}
