//! Wheels and track joined at the contacts: how the irregularity and the varying deflection of the track make the
//! contact forces of a bogie deviate from the static ones.
//!
//! With the wheel pressed down by Q and positive displacement down, the deviation d = f − Q moves the wheel by −α_w d,
//! the rail by G d and compresses the contact by C_H d; a wheel in contact follows rail plus irregularity, so
//! (α_w + G + C_H) d = −(z + w_s), with z the irregularity and w_s the variation of the deflection under the static load.
//! The contact is linearised at Q (loss of contact is left to the wheels' own deviations). The four contacts of a bogie
//! are coupled by the sleepers, by the wheelsets' roll and by the bogie frame; the two wheelsets of a bogie are too far
//! apart to feel each other through the rail.

mod wheelset;

pub use wheelset::Wheelset;

use std::sync::Arc;

use faer::linalg::matmul::matmul;
use faer::linalg::solvers::DenseSolveCore as _;
use faer::{Accum, Mat, MatRef, Par, c64};

use crate::greens::moving_response::{RailGreens, RailNodes};
use crate::greens::{Chain, GreensFunctions, GreensSampling, Quantity};
use crate::recording::Vehicle;
use crate::signal::{CubicSpline, irfft, taper};
use crate::track::Track;

/// Interaction of a bogie with the calibrated track.
#[derive(Clone, Debug)]
pub struct Interaction {
    /// `[read][loaded]`, crossing and stock rail.
    rails: [[RailGreens; 2]; 2],
    /// Deflection under a wheel per half the static load of its companion, m/N, along x: `[rail][companion at larger x]`.
    companion: [[CubicSpline; 2]; 2],
    /// Static force of wheels on the crossing and on the stock rail, of half an axle's.
    load_factor: [f64; 2],
    bogie: Arc<BogieResponses>,
}

/// A bogie without track: displacement of a contact per force impulse on contacts of the same bogie, on the same rail and
/// on the other one.
#[derive(Clone, Debug)]
pub struct BogieResponses {
    sampling: GreensSampling,
    hertz_constant_n_m15: f64,
    axle_spacing_m: f64,
    /// Of the same wheelset, periodic time series, metres per newton at one sample.
    same_wheelset: [Vec<f64>; 2],
    /// Of the other wheelset, spectra of the same.
    other_wheelset: [Vec<c64>; 2],
}

/// The four contacts of a bogie moving at a speed: [`Motion::solve`] turns irregularities into force deviations.
pub struct Motion<'a> {
    interaction: &'a Interaction,
    position_m: &'a [f64],
    direction: f64,
    static_force_n: f64,
    /// Inverse of the compliance of the contacts, N/m, in the order leading crossing, leading stock, trailing crossing,
    /// trailing stock; every one on its wheel's own clock. With so many right-hand sides, most of them zero on most
    /// contacts, the inverse costs less than they would.
    stiffness: Mat<f64>,
    rails: RailKernels,
}

/// Deflection under a wheel per force on it at its own samples, `[read][loaded]`: positions × positions, m/N.
type RailKernels = [[Mat<f64>; 2]; 2];

/// One column set per contact: `[leading, trailing][crossing, stock]`, positions × cases.
pub type Contacts = [[Mat<f64>; 2]; 2];

impl Interaction {
    /// For forces within `half_m` of x = 0.
    pub fn new(track: &Track, ballast_n_m2: &[f64], bogie: &Arc<BogieResponses>, half_m: f64) -> Self {
        let rails = RailGreens::of_both_rails(track, ballast_n_m2, half_m, bogie.sampling);
        Self::on_rails(rails, track, ballast_n_m2, bogie, half_m)
    }

    /// The same, and the Green's functions of the sensor: they share the factors of the track, half the work of both.
    pub fn and_sensor(
        track: &Track,
        ballast_n_m2: &[f64],
        bogie: &Arc<BogieResponses>,
        half_m: f64,
        (quantity, chain): (Quantity, &Chain),
    ) -> (Self, GreensFunctions) {
        let sampling = bogie.sampling;
        let nodes = RailNodes::within(track, half_m);
        let (sensor, pairs) =
            track.sensor_and_rail_receptances(&sampling.frequencies_hz(), ballast_n_m2, nodes.range());
        let rails = RailGreens::of_receptances(track, &nodes, &pairs, sampling);
        let greens = GreensFunctions::of_receptance(track, &sensor, sampling, quantity, chain);
        (Self::on_rails(rails, track, ballast_n_m2, bogie, half_m), greens)
    }

    fn on_rails(
        rails: [[RailGreens; 2]; 2],
        track: &Track,
        ballast_n_m2: &[f64],
        bogie: &Arc<BogieResponses>,
        half_m: f64,
    ) -> Self {
        let companion = companion_compliance(track, ballast_n_m2, half_m, bogie.axle_spacing_m);
        Self { rails, companion, load_factor: track.load_factor, bogie: Arc::clone(bogie) }
    }

    /// Wheels at `position_m`, one per time step on their own clocks, in the order of passing; `static_force_n`: mean of an axle's.
    pub fn moving<'a>(
        &'a self,
        position_m: &'a [f64],
        direction: f64,
        speed_m_s: f64,
        static_force_n: f64,
    ) -> Motion<'a> {
        let n = position_m.len();
        let delay = self.bogie.axle_spacing_m / speed_m_s * self.bogie.sampling.rate_hz;
        let contact = self.contact_compliance_m_n(static_force_n);
        // The trailing wheelset's clock is late: what happens to it comes to the leading one later.
        let to_leading = self.bogie.other_wheelset(delay);
        let to_trailing = self.bogie.other_wheelset(-delay);
        let rails = self.rail_kernels(position_m);
        let both_rails = |block: &dyn Fn(usize, usize) -> Mat<f64>| {
            let mut out = Mat::zeros(2 * n, 2 * n);
            for (read, loaded) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
                out.submatrix_mut(read * n, loaded * n, n, n).copy_from(&block(read, loaded));
            }
            out
        };
        let mut own = both_rails(&|read, loaded| self.within_wheelset(&rails, read, loaded));
        for i in 0..2 * n {
            own[(i, i)] += contact[i / n];
        }
        let across = [to_leading, to_trailing]
            .map(|of| both_rails(&|read, loaded| toeplitz(&of[usize::from(read != loaded)], n)));
        let stiffness = inverse_of_twins(&own, &across);
        Motion { interaction: self, position_m, direction, static_force_n, stiffness, rails }
    }

    /// Compliance of the contacts on the crossing and on the stock rail, each linearised at its static force.
    fn contact_compliance_m_n(&self, static_force_n: f64) -> [f64; 2] {
        self.load_factor.map(|factor| self.bogie.contact_compliance_m_n(factor * static_force_n))
    }

    /// Displacement at a contact per force on a contact of the same wheelset, its own contact's compression apart.
    fn within_wheelset(&self, rails: &RailKernels, read: usize, loaded: usize) -> Mat<f64> {
        let kernel = &rails[read][loaded];
        kernel + toeplitz(&self.bogie.same_wheelset[usize::from(read != loaded)], kernel.nrows())
    }

    fn rail_kernels(&self, position_m: &[f64]) -> RailKernels {
        [0, 1].map(|read: usize| [0, 1].map(|loaded: usize| self.rails[read][loaded].kernel(position_m)))
    }
}

/// Displacement at own sample k per force at own sample j, from a periodic impulse response.
fn toeplitz(series: &[f64], n: usize) -> Mat<f64> {
    let before = |lags: usize| &series[series.len() - lags..];
    let mut out = Mat::zeros(n, n);
    for j in 0..n {
        let (earlier, later) = out.col_as_slice_mut(j).split_at_mut(j);
        earlier.copy_from_slice(before(j));
        later.copy_from_slice(&series[..n - j]);
    }
    out
}

/// Inverse of [[own, to leading], [to trailing, own]]: both wheelsets meet the same rails and have the same inertia. By the Schur
/// complement of one of them; a wheelset follows its own force far more than its companion's, so that this is as exact as an inverse
/// of the whole, in half its time.
fn inverse_of_twins(own: &Mat<f64>, [to_leading, to_trailing]: &[Mat<f64>; 2]) -> Mat<f64> {
    let m = own.nrows();
    let alone = own.partial_piv_lu().inverse();
    let (right, left) = (&alone * to_leading, to_trailing * &alone);
    let trailing = (own - to_trailing * &right).partial_piv_lu().inverse();
    let (upper, lower) = (&right * &trailing, &trailing * &left);
    let mut out = Mat::zeros(2 * m, 2 * m);
    out.submatrix_mut(0, 0, m, m).copy_from(&alone + &upper * &left);
    out.submatrix_mut(0, m, m, m).copy_from(-upper);
    out.submatrix_mut(m, 0, m, m).copy_from(-lower);
    out.submatrix_mut(m, m, m, m).copy_from(&trailing);
    out
}

/// For every axle and rail.
fn contacts(of: impl Fn(usize, usize) -> Mat<f64>) -> Contacts {
    [0, 1].map(|axle: usize| [0, 1].map(|rail: usize| of(axle, rail)))
}

impl Motion<'_> {
    /// Force at the contact `[axle, rail]` per displacement at another.
    fn between(&self, [axle, rail]: [usize; 2], [other_axle, other_rail]: [usize; 2]) -> MatRef<'_, f64> {
        let n = self.position_m.len();
        self.stiffness.submatrix((2 * axle + rail) * n, (2 * other_axle + other_rail) * n, n, n)
    }

    /// Force deviations, newtons, for irregularities (metres) under the contacts; one column each.
    pub fn solve(&self, irregularity_m: &Contacts) -> Contacts {
        contacts(|axle, rail| {
            let from = |a: usize, r: usize| self.between([axle, rail], [a, r]) * &irregularity_m[a][r];
            -(from(0, 0) + from(0, 1) + from(1, 0) + from(1, 1))
        })
    }

    /// Force deviations, newtons per unit, for irregularities of the rails that both wheelsets meet, `[crossing, stock]`,
    /// metres per unit. Columns: first those of the crossing rail, then those of the stock rail.
    pub fn solve_shared(&self, irregularity_m: &[Mat<f64>; 2]) -> Contacts {
        let n = self.position_m.len();
        let columns = irregularity_m[0].ncols() + irregularity_m[1].ncols();
        contacts(|axle, rail| {
            let mut out = Mat::zeros(n, columns);
            let mut first = 0;
            for (r, shape) in irregularity_m.iter().enumerate() {
                let both = self.between([axle, rail], [0, r]) + self.between([axle, rail], [1, r]);
                let target = out.subcols_mut(first, shape.ncols());
                matmul(target, Accum::Replace, &both, shape, -1.0, Par::Seq);
                first += shape.ncols();
            }
            out
        })
    }

    /// Force deviation of every contact per irregularity under that contact alone, N/m.
    pub fn alone(&self) -> Contacts {
        contacts(|axle, rail| -self.between([axle, rail], [axle, rail]))
    }

    /// Force deviations under the track of `other`, which is so near this one that its compliance may stand in for the
    /// other's in what the difference makes (an error of the difference squared); `force_n` are those under this track,
    /// one column per contact.
    ///
    /// With C d = −(z + w_s) here and C′ d′ = −(z + w_s′) there, C (d′ − d) ≈ −(w_s′ − w_s) − (C′ − C) d, and only the
    /// rails of C differ.
    pub fn nearby(&self, other: &Interaction, force_n: &Contacts) -> Contacts {
        let there = other.rail_kernels(self.position_m);
        let (w, w_there) = (
            self.load_deflection_m(),
            other.load_deflection_m(&there, self.position_m, self.direction, self.static_force_n),
        );
        let moved = contacts(|axle, read| {
            let of =
                |loaded: usize| (&there[read][loaded] - &self.rails[read][loaded]) * &force_n[axle][loaded];
            &w_there[axle][read] - &w[axle][read] + of(0) + of(1)
        });
        let change = self.solve(&moved);
        contacts(|axle, rail| &force_n[axle][rail] + &change[axle][rail])
    }

    /// Variation of the deflection under the constant load along the positions, metres; one column.
    pub fn load_deflection_m(&self) -> Contacts {
        self.interaction.load_deflection_m(&self.rails, self.position_m, self.direction, self.static_force_n)
    }
}

impl Interaction {
    /// Variation of the deflection under the constant load along the positions, metres, relative to the ends, where it
    /// fades in: a constant deflection moves the whole vehicle and makes no force. The ballast's damping makes the
    /// deflection lag behind that of a standing load by several milliseconds. One column.
    fn load_deflection_m(
        &self,
        rails: &RailKernels,
        position_m: &[f64],
        direction: f64,
        static_force_n: f64,
    ) -> Contacts {
        let n = position_m.len();
        let reach = position_m.iter().fold(0.0, |m: f64, x| m.max(x.abs()));
        let from_end = |i: usize| reach - position_m[i].abs();
        let coming =
            Mat::from_fn(n, 1, |i, _| if i < n / 2 { 1.0 - taper(from_end(i), 0.0, RAMP_M) } else { 1.0 });
        let coming = self.load_factor.map(|factor| &coming * faer::Scale(factor));
        let moving_load =
            [0, 1].map(|read: usize| &rails[read][0] * &coming[0] + &rails[read][1] * &coming[1]);
        contacts(|axle, rail| {
            // The companion of the leading wheel is behind it: at smaller x in facing direction.
            let companion_ahead_in_x = (axle == 1) == (direction > 0.0);
            let spline = &self.companion[rail][usize::from(companion_ahead_in_x)];
            let value: Vec<f64> = (0..n)
                .map(|i| static_force_n * (moving_load[rail][(i, 0)] + spline.at(position_m[i])))
                .collect();
            let ends: Vec<f64> =
                (0..n).filter(|i| (RAMP_M..END_M).contains(&from_end(*i))).map(|i| value[i]).collect();
            let level = crate::signal::mean(&ends);
            Mat::from_fn(n, 1, |i, _| (value[i] - level) * (1.0 - taper(from_end(i), RAMP_M, END_M)))
        })
    }
}

/// Ends of the stretch of unknown forces: the load comes on over the first, the deflection fades in up to the second.
const RAMP_M: f64 = 0.6;
const END_M: f64 = 1.8;

/// Deflection of each rail under a wheel of a bogie per half the static load of its companion:
/// `[rail][companion at larger x]`. The companion is far enough away for its standing load to do.
fn companion_compliance(
    track: &Track,
    ballast_n_m2: &[f64],
    half_m: f64,
    axle_spacing_m: f64,
) -> [[CubicSpline; 2]; 2] {
    let reach = half_m + axle_spacing_m + 2.0 * track.step_m;
    let nodes: Vec<usize> = (0..track.node_x_m.len()).filter(|i| track.node_x_m[*i].abs() <= reach).collect();
    let x: Vec<f64> = nodes.iter().map(|i| track.node_x_m[*i]).collect();
    let deflection = track.static_deflections_under_axle(ballast_n_m2, &nodes);
    [0, 1].map(|rail: usize| {
        let shapes: Vec<Option<CubicSpline>> =
            deflection.iter().map(|d| CubicSpline::new(&x, &d[rail])).collect();
        [-1.0, 1.0].map(|toward: f64| {
            // By reciprocity, what this wheel's load does at the companion is what the companion's does here.
            let at = |(shape, x): (&Option<CubicSpline>, &f64)| {
                shape.as_ref().map_or(0.0, |s| s.at(x + toward * axle_spacing_m))
            };
            let y: Vec<f64> = shapes.iter().zip(&x).map(at).collect();
            CubicSpline::new(&x, &y).unwrap_or_else(CubicSpline::zero)
        })
    })
}

/// The car body holds the bogie frame with a constant force; a soft secondary suspension of this natural frequency
/// and damping stands for it, so that the responses decay within their period, which is [`BOGIE_PERIODS`] times that of
/// the sampling.
const SECONDARY_HZ: f64 = 0.1;
const SECONDARY_DAMPING: f64 = 0.7;
const BOGIE_PERIODS: usize = 32;

impl BogieResponses {
    /// Two rigid wheelsets (heave and roll) on primary suspensions under a rigid frame (heave, pitch and roll).
    pub fn new(vehicle: &Vehicle, track_sampling: GreensSampling) -> Self {
        let sampling = GreensSampling { len: BOGIE_PERIODS * track_sampling.len, ..track_sampling };
        let mut spectra: [Vec<c64>; 4] = std::array::from_fn(|_| Vec::with_capacity(sampling.len / 2));
        for f in sampling.frequencies_hz() {
            let gain = taper(f, sampling.band_hz[0], sampling.band_hz[1]);
            for (s, c) in spectra.iter_mut().zip(bogie_compliance(vehicle, std::f64::consts::TAU * f)) {
                s.push(c * gain);
            }
        }
        let [own, across, along, diagonal] = spectra.map(|mut s| {
            s.resize(sampling.len / 2 + 1, c64::new(0.0, 0.0));
            s
        });
        Self {
            sampling: track_sampling,
            hertz_constant_n_m15: vehicle.hertz_constant_n_m15,
            axle_spacing_m: vehicle.axle_spacing_m,
            same_wheelset: [irfft(&own, sampling.len), irfft(&across, sampling.len)],
            other_wheelset: [along, diagonal],
        }
    }

    /// Of the contact, linearised at the static force.
    fn contact_compliance_m_n(&self, static_force_n: f64) -> f64 {
        1.0 / (1.5 * self.hertz_constant_n_m15.powf(2.0 / 3.0) * static_force_n.cbrt())
    }

    /// Series of the other wheelset, later by `delay` samples.
    fn other_wheelset(&self, delay: f64) -> [Vec<f64>; 2] {
        let len = self.same_wheelset[0].len();
        let turn = c64::new(0.0, -std::f64::consts::TAU * delay / len as f64).exp();
        [0, 1].map(|rail: usize| {
            let mut phasor = c64::new(1.0, 0.0);
            let delayed: Vec<c64> = self.other_wheelset[rail]
                .iter()
                .map(|v| {
                    let value = v * phasor;
                    phasor *= turn;
                    value
                })
                .collect();
            irfft(&delayed, len)
        })
    }
}

/// Displacement of a contact per force on it, on the contact across, along and diagonally opposite, m/N.
fn bogie_compliance(vehicle: &Vehicle, omega: f64) -> [c64; 4] {
    let real = |v: f64| c64::new(v, 0.0);
    let square = omega * omega;
    let box_stiffness = c64::new(
        2.0 * vehicle.primary_stiffness_per_axle_box_n_m,
        2.0 * omega * vehicle.primary_damping_per_axle_box_ns_m,
    );
    let own_frequency = std::f64::consts::TAU * SECONDARY_HZ;
    let held = c64::new(own_frequency * own_frequency, 2.0 * SECONDARY_DAMPING * own_frequency * omega);
    // Both wheelsets in phase or in opposition; `inertia` that the frame brings into the motion, seen at the wheelsets.
    let mode = |mass: f64, stiffness: c64, inertia: f64, carried: f64| {
        let frame = held * carried + stiffness * 2.0 - real(square * inertia);
        real(1.0) / (stiffness - real(square * mass) - stiffness * stiffness * 2.0 / frame)
    };
    let half = vehicle.axle_spacing_m / 2.0;
    let (m, frame) = (vehicle.wheelset_mass_kg, vehicle.bogie_frame_mass_kg);
    let heave = mode(m, box_stiffness, frame, frame + 2.0 * m);
    let pitch_inertia = vehicle.bogie_frame_pitch_inertia_kg_m2 / (half * half);
    let pitch = mode(m, box_stiffness, pitch_inertia, pitch_inertia + 2.0 * m);
    let roll_stiffness = box_stiffness * vehicle.axle_box_half_distance_m.powi(2);
    let i = vehicle.wheelset_roll_inertia_kg_m2;
    let frame_roll = vehicle.bogie_frame_roll_inertia_kg_m2;
    let roll = mode(i, roll_stiffness, frame_roll, frame_roll + 2.0 * i);
    let twist = real(1.0) / (roll_stiffness - real(square * i));
    let lever = vehicle.contact_half_distance_m.powi(2);
    let (heave_own, heave_other) = ((heave + pitch) * 0.5, (heave - pitch) * 0.5);
    let (roll_own, roll_other) = ((roll + twist) * (0.5 * lever), (roll - twist) * (0.5 * lever));
    [heave_own + roll_own, heave_own - roll_own, heave_other + roll_other, heave_other - roll_other]
}
