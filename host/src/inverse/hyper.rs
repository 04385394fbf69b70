//! Hyper-parameters of the prior by evidence: one after the other, by factors of two as long as that helps. Estimates
//! hardly depend on them within such a factor.

use super::{InverseError, Prior};

/// A positive hyper-parameter with the range in which it is physical.
pub struct Hyper {
    get: fn(&mut Prior) -> &mut f64,
    range: [f64; 2],
}

/// In the order in which they matter. Ranges: from nothing measurable to the recorder's full noise, the depth of a broken
/// crossing, a corrugated stock rail; the correlation length from one sleeper's height to a sleeper bay.
pub const IRREGULARITY: [Hyper; 8] = [
    Hyper { get: |p| &mut p.noise_m_s2, range: [0.005, 1.0] },
    Hyper { get: |p| &mut p.own.region, range: [2e-6, 2e-3] },
    Hyper { get: |p| &mut p.own.outside, range: [1e-6, 0.5e-3] },
    Hyper { get: |p| &mut p.own_correlation_m, range: [0.05, 0.6] },
    Hyper { get: |p| &mut p.common.region, range: [0.01e-3, 10e-3] },
    Hyper { get: |p| &mut p.common.outside, range: [2e-6, 0.5e-3] },
    Hyper { get: |p| &mut p.own.stock, range: [1e-6, 0.1e-3] },
    Hyper { get: |p| &mut p.dip_m, range: [0.1e-3, 10e-3] },
];

/// Those of a common force profile: up to the recorder's full noise and the size of the static force; the rails outside the
/// region and the stock rail are smooth.
pub const FORCE: [Hyper; 5] = [
    Hyper { get: |p| &mut p.noise_m_s2, range: [0.04, 1.0] },
    Hyper { get: |p| &mut p.own.region, range: [200.0, 60e3] },
    Hyper { get: |p| &mut p.own.outside, range: [200.0, 20e3] },
    Hyper { get: |p| &mut p.own.stock, range: [100.0, 1.2e3] },
    Hyper { get: |p| &mut p.correlation_s, range: [0.7e-3, 5e-3] },
];

/// Step of a hyper-parameter, as a factor.
const FACTOR: f64 = 2.0;

/// Prior with the highest evidence found.
pub fn refine(
    start: &Prior,
    hypers: &[Hyper],
    evidence: &dyn Fn(&Prior) -> Result<f64, InverseError>,
) -> Result<Prior, InverseError> {
    let mut best = start.clone();
    let mut highest = evidence(&best)?;
    for hyper in hypers {
        for step in [FACTOR, 1.0 / FACTOR] {
            if climb(hyper, step, &mut best, &mut highest, evidence) {
                break;
            }
        }
    }
    Ok(best)
}

/// Repeats a step while it helps; tells whether it ever did.
fn climb(
    hyper: &Hyper,
    step: f64,
    best: &mut Prior,
    highest: &mut f64,
    evidence: &dyn Fn(&Prior) -> Result<f64, InverseError>,
) -> bool {
    let mut moved = false;
    loop {
        let mut candidate = best.clone();
        let value = (hyper.get)(&mut candidate);
        *value *= step;
        if *value < hyper.range[0] || *value > hyper.range[1] {
            return moved;
        }
        // A candidate whose covariance breaks down is simply no improvement.
        match evidence(&candidate) {
            Ok(found) if found > *highest => (*best, *highest, moved) = (candidate, found, true),
            _ => return moved,
        }
    }
}
