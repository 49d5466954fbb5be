//! The same problem for Clarabel: `min ||r||^2, S w - r = target, sum w = 1, w >= 0`.
use super::common::Instance;
use clarabel::algebra::CscMatrix;
use clarabel::solver::{DefaultSettingsBuilder, DefaultSolver, IPSolver, SupportedConeT};

pub fn clarabel(x: &Instance, tol: f64) -> Vec<f64> {
    let (n, d) = (x.size, x.lines * x.length);
    // Scaled so that ||target|| = 1.
    let scale = x.target.iter().chain(&x.g).fold(0.0_f64, |m, v| m.max(v.abs())).max(f64::MIN_POSITIVE);
    let (mut colptr, mut rowval, mut nzval) = (vec![0], Vec::new(), Vec::new());
    for i in 0..n {
        for j in 0..x.lines {
            rowval.push(j * x.length + x.indices[i * x.lines + j] as usize);
            nzval.push(x.g[j] / scale);
        }
        rowval.push(d);
        nzval.push(1.0);
        rowval.push(d + 1 + i);
        nzval.push(-1.0);
        colptr.push(rowval.len());
    }
    for k in 0..d {
        rowval.push(k);
        nzval.push(-1.0);
        colptr.push(rowval.len());
    }
    let a = CscMatrix::new(d + 1 + n, n + d, colptr, rowval, nzval);
    let mut b: Vec<f64> = x.target.iter().map(|t| t / scale).collect();
    b.push(1.0);
    b.extend(vec![0.0; n]);
    let mut pptr = vec![0; n + 1];
    pptr.extend(1..=d);
    let p = CscMatrix::new(n + d, n + d, pptr, (n..n + d).collect(), vec![2.0; d]);
    let settings = DefaultSettingsBuilder::default()
        .verbose(false)
        .max_threads(1)
        .tol_gap_abs(tol)
        .tol_gap_rel(tol)
        .tol_feas(tol)
        .build()
        .unwrap();
    let cones = [SupportedConeT::ZeroConeT(d + 1), SupportedConeT::NonnegativeConeT(n)];
    let mut solver = DefaultSolver::new(&p, &vec![0.0; n + d], &a, &b, &cones, settings).unwrap();
    solver.solve();
    let mut w: Vec<f64> = solver.solution.x[..n].iter().map(|v| v.max(0.0)).collect();
    let total: f64 = w.iter().sum();
    w.iter_mut().for_each(|v| *v /= total);
    w
}
