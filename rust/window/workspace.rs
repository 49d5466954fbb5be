//! Memory for the decompositions of small matrices, held from call to call.

use std::mem::MaybeUninit;

use faer::diag::DiagMut;
use faer::dyn_stack::{MemStack, StackReq};
use faer::linalg::cholesky::llt::factor as llt;
use faer::linalg::evd::{self, ComputeEigenvectors};
use faer::linalg::lu::partial_pivoting as lu;
use faer::{MatMut, MatRef, Par};

use crate::error::Result;
use crate::memory::{try_filled, try_zeros};

use super::shape::WHAT;

#[derive(Debug, Clone)]
pub(crate) struct Workspace {
    memory: Vec<MaybeUninit<u8>>,
    values: Vec<f64>,
    order: [Vec<usize>; 2],
}

impl Workspace {
    /// For matrices of up to so many rows, and right sides of up to so many columns.
    pub(crate) fn new(rows: usize, columns: usize) -> Result<Self> {
        let of = |k: usize| {
            StackReq::any_of(&[
                evd::self_adjoint_evd_scratch::<f64>(k, ComputeEigenvectors::No, Par::Seq, Default::default()),
                llt::cholesky_in_place_scratch::<f64>(k, Par::Seq, Default::default()),
                lu::factor::lu_in_place_scratch::<usize, f64>(k, k, Par::Seq, Default::default()),
                lu::solve::solve_in_place_scratch::<usize, f64>(k, columns, Par::Seq),
            ])
        };
        let bytes = (1..=rows).fold(StackReq::EMPTY, |all, k| all.or(of(k))).unaligned_bytes_required();
        let (memory, order) = (try_filled(WHAT, MaybeUninit::uninit(), bytes)?, || try_zeros(WHAT, rows));
        Ok(Self { memory, values: try_zeros(WHAT, rows)?, order: [order()?, order()?] })
    }

    /// The largest eigenvalue of a symmetric matrix; None where it is not found.
    pub(crate) fn largest(&mut self, a: MatRef<'_, f64>) -> Option<f64> {
        let (values, stack) = (&mut self.values[..a.nrows()], MemStack::new(&mut self.memory));
        evd::self_adjoint_evd(a, DiagMut::from_slice_mut(values), None, Par::Seq, stack, Default::default()).ok()?;
        values.last().copied()
    }

    /// `L` of `L L' = a` in the lower triangle of `a`; false where it is not positive definite.
    pub(crate) fn factored(&mut self, a: MatMut<'_, f64>) -> bool {
        let stack = MemStack::new(&mut self.memory);
        llt::cholesky_in_place(a, Default::default(), Par::Seq, stack, Default::default()).is_ok()
    }

    /// `x <- a^-1 x`; what is in `a` is used up.
    pub(crate) fn solve(&mut self, mut a: MatMut<'_, f64>, x: MatMut<'_, f64>) {
        let (stack, [to, from]) = (MemStack::new(&mut self.memory), &mut self.order);
        let (to, from) = (&mut to[..a.nrows()], &mut from[..a.nrows()]);
        let (_, order) = lu::factor::lu_in_place(a.as_mut(), to, from, Par::Seq, stack, Default::default());
        lu::solve::solve_in_place(a.as_ref(), a.as_ref(), order, x, Par::Seq, stack);
    }
}
