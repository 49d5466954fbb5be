//! Covariances of `M` times `A x0^s`, `xf^s`, `A^s x0` and `(A^s - A)(x0^s - x0)`.

use super::covariance::{Averaged, Sampling, around, pushed};
use super::image::Image;
use crate::control::transposed;
use crate::error::Result;

/// The four covariances (rank, rank), and their traces; for columns the last two are sums of nonnegative terms.
#[derive(Debug)]
pub(super) struct Moments {
    pub covariances: [Vec<f64>; 4],
    pub traces: [f64; 4],
}

impl Moments {
    pub(super) fn new(of: &Image) -> Result<Self> {
        let (x0, r, average) = (&of.x0, of.rank(), Sampling::ONE);
        let (map, c0) = (transposed(&of.images, r)?, average.covariance(x0)?);
        let lines = Averaged { entries: &of.a, columns: of.n, rows: of.rows, average };
        let covariances = [
            pushed(&of.moved, x0, r)?,
            pushed(&of.images, &of.xf, r)?,
            around(&map, &lines.excess(None, Some(x0))?, of.n)?,
            around(&map, &lines.excess(Some(&c0), None)?, of.n)?,
        ];
        let mut traces = [0.0; 4];
        traces.iter_mut().zip(&covariances).for_each(|(to, c)| *to = c.iter().step_by(r + 1).sum::<f64>().max(0.0));
        if !of.rows {
            traces[2] = of.tau.iter().zip(x0).map(|(tau, x)| tau * x * x).sum();
            traces[3] = of.tau.iter().zip(c0.iter().step_by(of.n + 1)).map(|(tau, own)| tau * own).sum();
        }
        Ok(Self { covariances, traces })
    }
}
