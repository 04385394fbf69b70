//! A measured receptance beside the modelled one: hits of an instrumented hammer on the crossing rail, read by the site's
//! own sensor.
//!
//! No wheel, no irregularity and no axle time is in it, so it tells what is wrong with the track from everything else. It is
//! that of the unloaded track: a sleeper above its bed hangs, and what holds it under a train does not count.

use faer::c64;

use super::GapError;
use super::receptance::{Receptance, ReceptanceError};
use super::world::World;
use crate::beam;
use crate::passage::SupportLaw;
use crate::track::{Mesh, Side, Track};

/// Frequencies compared, Hz: below, a hammer moves too little, above, the diagnosis does not look.
pub const BAND_HZ: [f64; 2] = [20.0, 250.0];
/// Lines nearer than this say the same, Hz: the track's resonances are wider.
const SPACING_HZ: f64 = 10.0;
/// Relative error of the modelled receptance where nothing is wrong: the ballast under a hammer is softer than under a train.
const MODEL_ERROR: f64 = 0.15;
/// Degrees of freedom of the distribution of its errors: single lines, at antiresonances, may be far off.
const FREEDOM: f64 = 4.0;
/// Median deviation up to which model and hammer agree, and from which the track is not as modelled.
const AGREES: f64 = 0.15;
const DIFFERS: f64 = 0.3;

/// Factor between the measured receptance and that of the track as described, median over the lines, beyond which units are wrong: pads
/// of a twentieth of their stiffness give 0.084. So g for m/s² (0.10) pass for a track with soft pads.
const UNLIKE_ANY_TRACK: f64 = 30.0;

/// A measured receptance, fit for comparison.
#[derive(Clone, Debug, PartialEq)]
pub struct Hammer {
    receptance: Receptance,
    x_m: f64,
}

/// What the hammer says of a model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Agreement {
    /// The track is as modelled.
    Agrees,
    /// In between.
    Doubtful,
    /// Something of the track is not as modelled.
    Differs,
}

impl Hammer {
    /// Hits at `x_m` on the crossing rail. Refuses a receptance whose band has gaps, or in which the hits do not agree.
    pub fn new(receptance: &Receptance, x_m: f64) -> Result<Self, ReceptanceError> {
        let trusted = receptance.trusted(BAND_HZ)?;
        let mut next_hz = 0.0;
        let receptance = trusted.lines(|f| {
            let keep = f >= next_hz;
            if keep {
                next_hz = f + SPACING_HZ;
            }
            keep
        });
        Ok(Self { receptance, x_m })
    }

    /// Log likelihood of the measured receptance if `world` were true, up to a constant.
    pub fn log_likelihood(&self, world: &World) -> Result<f64, GapError> {
        let r = &self.receptance;
        let errors = self.errors(world)?;
        let term = |(error, coherence): (&f64, &f64)| {
            // Of H1: Bendat and Piersol, Random Data, ch. 9.
            let measured = (1.0 - coherence) / (2.0 * r.hits as f64 * coherence.max(1e-3));
            (1.0 + error * error / (FREEDOM * (measured + MODEL_ERROR * MODEL_ERROR))).ln()
        };
        Ok(-0.5 * (FREEDOM + 2.0) * errors.iter().zip(&r.coherence).map(term).sum::<f64>())
    }

    /// Median over the lines of the model's departure, relative to the measured receptance.
    pub fn deviation(&self, world: &World) -> Result<f64, GapError> {
        Ok(crate::signal::quantile(&self.errors(world)?, 0.5))
    }

    /// Refuses what no track can have, seen from the track as described: then it was not measured in SI units.
    pub fn check(&self, described: &World) -> Result<(), GapError> {
        let modelled = modelled(described, &self.receptance.frequency_hz, self.x_m)?;
        let ratios: Vec<f64> =
            self.receptance.receptance_m_n.iter().zip(&modelled).map(|(r, m)| r.norm() / m.norm()).collect();
        let ratio = crate::signal::quantile(&ratios, 0.5);
        match (1.0 / UNLIKE_ANY_TRACK..=UNLIKE_ANY_TRACK).contains(&ratio) {
            true => Ok(()),
            false => Err(GapError::HammerScale { ratio }),
        }
    }

    /// Departures, relative to the measured receptance.
    fn errors(&self, world: &World) -> Result<Vec<f64>, GapError> {
        let modelled = modelled(world, &self.receptance.frequency_hz, self.x_m)?;
        let measured = &self.receptance.receptance_m_n;
        Ok(modelled.iter().zip(measured).map(|(m, r)| (m / r - 1.0).norm()).collect())
    }
}

impl Agreement {
    /// Of a median deviation.
    pub fn of(deviation: f64) -> Self {
        match deviation {
            d if d < AGREES => Self::Agrees,
            d if d < DIFFERS => Self::Doubtful,
            _ => Self::Differs,
        }
    }
}

/// Receptance between a force at `x_m` on the crossing rail and the sensor, m/N, of the unloaded track of a world.
pub fn modelled(world: &World, frequency_hz: &[f64], x_m: f64) -> Result<Vec<c64>, GapError> {
    let mut crossing = world.crossing.clone();
    let sleeper = &mut crossing.sleeper;
    sleeper.density_kg_m3 += world.bed.mass_kg_m / (sleeper.width_m * sleeper.height_m);
    let nominal = Track::of_crossing(&crossing, Mesh::default());
    let track = world.ballast.under(&nominal);
    let ballast: Vec<f64> = super::forward::supports(world, &track)
        .iter()
        .map(|s| match s.law {
            SupportLaw::Unilateral { gap_m, preload_n_m } if gap_m > 0.0 && preload_n_m <= 0.0 => 0.0,
            _ => s.stiffness_n_m2,
        })
        .collect();
    let position = (x_m - track.node_x_m[0]) / track.step_m;
    let last = track.node_x_m.len() - 1;
    if !(position >= 0.0 && position <= last as f64) {
        let ends_m = [track.node_x_m[0], track.node_x_m[last]];
        return Err(GapError::HammerOutside { x_m, ends_m });
    }
    let e = (position as usize).min(last - 1);
    let phi = track.shear_ratio(Side::Crossing, e);
    let n = beam::shape(phi, track.step_m, position - e as f64);
    let sensor = &world.sensor;
    let nodal = track.sensor_receptance(frequency_hz, &ballast).crossing;
    Ok(nodal
        .iter()
        .zip(frequency_hz)
        .map(|(at, f)| {
            let motion = at[e][0] * n[0] + at[e][1] * n[1] + at[e + 1][0] * n[2] + at[e + 1][1] * n[3];
            motion * sensor.mounted(*f) * sensor.gain
        })
        .collect())
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::ballast::BallastParameters;
    use crate::gap::base::nominal_world;
    use crate::gap::receptance::Hit;
    use crate::passage::random::Random;
    use crate::passage::{SLEEPER_MODES, Stepper, TimeStep, TrackModel};
    use crate::recording::read_site;

    const X_M: f64 = 0.3;
    const DT_S: f64 = 1e-4;

    fn world() -> World {
        let dir = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data/field/reference-2");
        nominal_world(&read_site(&dir).unwrap(), BallastParameters::NOMINAL).unwrap()
    }

    /// A hit in the time domain: reduced sleepers, average acceleration, unilateral beds as in a passage.
    fn hit(world: &World, seed: u64) -> Hit {
        let mut random = Random::new(seed, 0);
        let track = Track::of_crossing(&world.crossing, Mesh::default());
        let model =
            TrackModel::new(&track, crate::gap::forward::supports(world, &track), SLEEPER_MODES).unwrap();
        let stepper = Stepper::new(model, TimeStep { dt_s: DT_S, theta: 0.5 }).unwrap();
        let point = stepper.model.point(Side::Crossing, X_M).unwrap();
        let mut state = stepper.at_rest();
        let (n, contact) = (8192, 30.0);
        let strength = 5e3 * (1.0 + 0.5 * random.unit());
        let force: Vec<f64> = (0..n)
            .map(|k| k as f64 / contact)
            .map(|p| if p < 1.0 { strength * (std::f64::consts::PI * p).sin().powi(2) } else { 0.0 })
            .collect();
        let sensor: Vec<f64> = force
            .iter()
            .map(|f| {
                stepper.begin(&mut state);
                stepper.load(&mut state, &point, *f);
                stepper.finish(&mut state);
                stepper.sensor_m(&state)
            })
            .collect();
        let acceleration_m_s2 = (0..n)
            .map(|k| {
                let at = |j: i64| usize::try_from(k as i64 + j).ok().and_then(|i| sensor.get(i)).copied();
                let (a, b, c) = (at(-1).unwrap_or(0.0), at(0).unwrap_or(0.0), at(1).unwrap_or(sensor[n - 1]));
                (a - 2.0 * b + c) / (DT_S * DT_S) + 0.02 * random.normal()
            })
            .collect();
        Hit { rate_hz: 1.0 / DT_S, force_n: force, acceleration_m_s2 }
    }

    fn hammer(world: &World) -> Hammer {
        let hits: Vec<Hit> = (0..5).map(|k| hit(world, k)).collect();
        Hammer::new(&Receptance::of_hits(&hits, 260.0).unwrap(), X_M).unwrap()
    }

    #[test]
    fn property_hits_in_the_time_domain_have_the_modelled_receptance() {
        let world = world();
        let found = hammer(&world).deviation(&world).unwrap();
        assert!(found < 0.05, "{found}");
    }

    #[test]
    fn property_the_hammer_tells_which_track_it_hit() {
        let base = world();
        let mut pads = world();
        pads.crossing.pad.stiffness_n_m *= 3.0;
        let mut voids = world();
        voids.bed.gap_m = vec![(-1, 1e-3), (0, 1e-3), (1, 1e-3)];
        let worlds = [base, pads, voids];
        for (i, hit) in worlds.iter().enumerate() {
            let hammer = hammer(hit);
            let found: Vec<f64> = worlds.iter().map(|w| hammer.log_likelihood(w).unwrap()).collect();
            for (j, other) in found.iter().enumerate() {
                assert!(i == j || found[i] > other + 10.0, "{i}: {found:?}");
            }
            assert_eq!(Agreement::of(hammer.deviation(hit).unwrap()), Agreement::Agrees, "{i}");
        }
    }

    #[test]
    fn property_a_place_off_the_track_is_refused_with_its_ends() {
        let world = world();
        let error = modelled(&world, &[50.0], 1e3).unwrap_err();
        assert!(matches!(error, GapError::HammerOutside { x_m, .. } if x_m == 1e3), "{error}");
    }

    /// The track as described beside those with the softest and stiffest pads and ballast that there are: from 0.084 to 1.3 times.
    #[test]
    fn property_every_track_is_taken_and_kilonewtons_are_not() {
        let described = world();
        let lines: Vec<f64> = (20..=250).step_by(10).map(f64::from).collect();
        let of = |pads: f64, p: f64| {
            let mut world = world();
            world.crossing.pad.stiffness_n_m *= pads;
            world.ballast = BallastParameters::stiffness([p, p, 0.4]);
            let receptance_m_n = modelled(&world, &lines, X_M).unwrap();
            let coherence = vec![1.0; lines.len()];
            let frequency_hz = lines.clone();
            Hammer::new(&Receptance { frequency_hz, receptance_m_n, coherence, hits: 2 }, X_M).unwrap()
        };
        for pads in [0.05, 0.2, 1.0, 5.0, 20.0] {
            for ballast in [3e6, 10e6, 30e6, 100e6] {
                let checked = of(pads, ballast).check(&described);
                assert!(checked.is_ok(), "pads {pads}, ballast {ballast}: {checked:?}");
            }
        }
        let mut hits: Vec<Hit> = (0..2).map(|k| hit(&described, k)).collect();
        hits.iter_mut().flat_map(|h| &mut h.force_n).for_each(|f| *f *= 1e-3);
        let in_kilonewtons = Hammer::new(&Receptance::of_hits(&hits, 260.0).unwrap(), X_M).unwrap();
        let error = in_kilonewtons.check(&described).unwrap_err();
        assert!(
            matches!(error, GapError::HammerScale { ratio } if (ratio / 1e3 - 1.0).abs() < 0.1),
            "{error}"
        );
    }
}
