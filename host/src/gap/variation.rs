//! How wheels of the same train differ from one another: what no model of the panel can know.
//!
//! The covariance of a bogie's window is a sum of parts with known shape and unknown size: load of a wheelset, share of
//! its two sides, depth and shift of its path through the crossing, its own irregularity, noise. The sizes follow from
//! the scatter of the bogies of each train about their mean, which holds no error that the bogies share.

use faer::Mat;
use faer::linalg::solvers::Llt;

use super::data::{RATE_HZ, stated_noise_m_s2};
use super::forward::BAND_HZ;
use super::linear::{BogieResponses, WheelMoves};
use super::splines::PathSplines;
use super::world::SensorModel;
use crate::recording::Sensor;
use crate::signal::{sum_in_order, taper};
use crate::track::Side;

/// Sizes (standard deviations) of the parts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Variation {
    /// Noise of a window sample, m/s².
    pub noise_m_s2: f64,
    /// Static force of a wheelset, relative.
    pub load: f64,
    /// Share of its crossing side, relative.
    pub side_load: f64,
    /// Depth of the path through the crossing, relative.
    pub depth: f64,
    /// Shift of that path, metres.
    pub shift_m: f64,
    /// Irregularity of each wheel on the crossing side, metres.
    pub own_m: f64,
    /// The same on the stock side, metres.
    pub own_stock_m: f64,
}

/// Noise is not taken for more than the end of its range, or for this many times what the sensor is said to have in the band:
/// it would stand in for what single wheels do, and then also hide what small parts of the signal tell.
const MOST_NOISE: f64 = 4.0;

/// Wheels without a defect differ in depth by less than this, relative: the reference recordings have up to 0.08, simulated sites
/// without effect 0.06, hollow wheels 0.27 and more.
pub const MOST_NATURAL_DEPTH: f64 = 0.12;
/// And in load by less than this, relative: over voids, loads and depths of the model take each other's part.
const MOST_NATURAL_LOAD: f64 = 0.02;
/// And in a path of their own by less than this on the crossing and on the stock side, metres: simulated sites without effect have
/// up to 19 and 207 µm, reference recordings 45 and 212 µm, wheels that lose contact among them. It tells large flats and waves
/// only: smaller ones look like the loss of contact.
const MOST_NATURAL_OWN_M: [f64; 2] = [75e-6, 500e-6];

/// Number of parts.
const PARTS: usize = 7;

impl Variation {
    /// Starting values; ranges keep the search physical.
    const START: Self = Self {
        noise_m_s2: 0.04,
        load: 0.01,
        side_load: 0.005,
        depth: 0.05,
        shift_m: 0.01,
        own_m: 10e-6,
        own_stock_m: 1e-6,
    };
    const RANGE: [[f64; 2]; PARTS] =
        [[0.01, 0.15], [1e-3, 0.1], [1e-3, 0.05], [1e-3, 0.3], [1e-3, 0.1], [1e-7, 3e-4], [1e-7, 1e-3]];

    /// How wheels differ beyond what they do by nature, in words.
    pub fn unnatural(&self) -> Option<String> {
        if self.depth > MOST_NATURAL_DEPTH {
            let percent = 100.0 * self.depth;
            return Some(format!(
                "by {percent:.0} % in how deep they run over the crossing: look for hollow and worn ones"
            ));
        }
        let sides = [(self.own_m, Side::Crossing), (self.own_stock_m, Side::Stock)];
        let (own_m, side) = sides.into_iter().zip(MOST_NATURAL_OWN_M).find(|((own, _), most)| own > most)?.0;
        let (own_um, side) = (1e6 * own_m, if side == Side::Crossing { "crossing" } else { "stock" });
        Some(format!(
            "by {own_um:.0} \u{b5}m in their own path on the {side} rail: look for flats and wheels out of round"
        ))
    }

    /// Whether loads and depths would have to differ by more than they ever do: what wheels do then is not linear in either, and the
    /// response of their mean is not the mean of their responses.
    pub fn beyond_linear(&self) -> bool {
        self.load >= Self::RANGE[1][1] && self.depth >= Self::RANGE[3][1]
    }

    /// Whether wheels run over the crossing at depths that sound ones do not, and loads do not stand in for what the panel does.
    pub fn worn(&self) -> bool {
        self.depth > MOST_NATURAL_DEPTH && self.load < MOST_NATURAL_LOAD
    }

    /// Whether noise stands in for what the parts leave of the scatter: as large as it may get.
    pub fn noisy(&self, sensor: &Sensor) -> bool {
        self.noise_m_s2 >= 0.99 * most_noise_m_s2(sensor)
    }

    fn values(&self) -> [f64; PARTS] {
        [self.noise_m_s2, self.load, self.side_load, self.depth, self.shift_m, self.own_m, self.own_stock_m]
    }

    fn of_values(v: [f64; PARTS]) -> Self {
        Self {
            noise_m_s2: v[0],
            load: v[1],
            side_load: v[2],
            depth: v[3],
            shift_m: v[4],
            own_m: v[5],
            own_stock_m: v[6],
        }
    }
}

/// Shapes of the parts of one passage's covariance, each for size 1.
pub struct Shapes {
    /// What the own path of the front and of the rear wheel adds to a window.
    pub moves: [WheelMoves; 2],
    parts: Vec<Mat<f64>>,
    /// What the square of a wheel's shift adds; its size follows from that of the shift.
    curvature: Mat<f64>,
    /// Correlation of the noise over distance in samples: it ends where the band of the windows does.
    noise: Vec<f64>,
    len: usize,
}

/// What is left of the noise beyond the band, m/s². It does not scale with the noise: a third of a window's directions lie
/// there, and would otherwise tell that there is none.
const OUT_OF_BAND_M_S2: f64 = 5e-3;

/// Correlation of noise that is white up to the end of the band: mostly what the model leaves of motion, which the sensor's mount amplifies
/// as it does motion.
fn band_noise(len: usize, sensor: &SensorModel) -> Vec<f64> {
    const LINES: usize = 400;
    let frequencies_hz = (0..LINES).map(|k| (k as f64 + 0.5) / LINES as f64 * 0.5 * RATE_HZ);
    let power = |f_hz: f64| taper(f_hz, BAND_HZ[0], BAND_HZ[1]).powi(2);
    let whole: f64 = frequencies_hz.clone().map(power).sum();
    let lines: Vec<(f64, f64)> =
        frequencies_hz.map(|f_hz| (f_hz, power(f_hz) * sensor.mounted(f_hz).norm_sqr())).collect();
    let at = |lag: usize| -> f64 {
        let phase = |f_hz: f64| std::f64::consts::TAU * f_hz * lag as f64 / RATE_HZ;
        lines.iter().map(|(f, shown)| shown * phase(*f).cos()).sum()
    };
    (0..len).map(|lag| at(lag) / whole).collect()
}

/// Variance of half the square of a Gaussian shift.
fn bend(shift_m: f64) -> f64 {
    0.5 * shift_m.powi(4)
}

/// Correlation length of a wheel's own irregularity, metres.
const OWN_CORRELATION_M: f64 = 0.12;

/// Correlation of the irregularity of single wheels between the knots of the path: crossing side, stock side.
pub struct OwnIrregularity {
    of_sides: [Mat<f64>; 2],
}

impl OwnIrregularity {
    /// For a path's splines.
    pub fn new(grids: &PathSplines) -> Self {
        let knots = grids.knots();
        let of = |side: Side| {
            Mat::from_fn(knots.len(), knots.len(), |i, j| {
                let ((a, x), (b, y)) = (knots[i], knots[j]);
                let both = a == side && b == side;
                if both { super::splines::matern((x - y).abs() / OWN_CORRELATION_M) } else { 0.0 }
            })
        };
        Self { of_sides: [Side::Crossing, Side::Stock].map(of) }
    }
}

impl Shapes {
    /// For the windows of one passage, as a sensor shows them.
    pub fn new(
        responses: &BogieResponses,
        moves: [WheelMoves; 2],
        own: &OwnIrregularity,
        sensor: &SensorModel,
    ) -> Self {
        let len = responses.profile[0].nrows();
        let mut parts: Vec<Mat<f64>> = (0..PARTS - 1).map(|_| Mat::zeros(len, len)).collect();
        let mut curvature = Mat::zeros(len, len);
        for axle in 0..2 {
            let a = &responses.profile[axle];
            let [c, s] = &responses.load[axle];
            let moves = &moves[axle];
            let column = |f: &dyn Fn(usize) -> f64| Mat::from_fn(len, 1, |k, _| f(k));
            add_outer(&mut parts[0], &column(&|k| c[k] + s[k]));
            add_outer(&mut parts[1], &column(&|k| c[k] - s[k]));
            add_outer(&mut parts[2], &column(&|k| moves.depth[k]));
            add_outer(&mut parts[3], &column(&|k| moves.shift[k]));
            add_outer(&mut curvature, &column(&|k| moves.curvature[k]));
            for (part, own) in [4, 5].into_iter().zip(&own.of_sides) {
                let half = a * own;
                parts[part] += &half * a.transpose();
            }
        }
        Self { moves, parts, curvature, noise: band_noise(len, sensor), len }
    }

    /// Covariance of one bogie's window.
    pub fn covariance(&self, variation: &Variation) -> Mat<f64> {
        let v = variation.values();
        let mut out = Mat::from_fn(self.len, self.len, |i, j| {
            v[0] * v[0] * self.noise[i.abs_diff(j)]
                + if i == j { OUT_OF_BAND_M_S2 * OUT_OF_BAND_M_S2 } else { 0.0 }
        });
        let squares = v[1..].iter().map(|size| size * size).chain([bend(variation.shift_m)]);
        for (part, square) in self.parts.iter().chain([&self.curvature]).zip(squares) {
            for j in 0..self.len {
                for i in 0..self.len {
                    out[(i, j)] += square * part[(i, j)];
                }
            }
        }
        out
    }

    /// Factor of that covariance.
    pub fn factor(&self, variation: &Variation) -> Option<Llt<f64>> {
        self.covariance(variation).llt(faer::Side::Lower).ok()
    }

    /// Log likelihood of the scatter of windows about their mean.
    fn log_likelihood(&self, variation: &Variation, scatter: &Mat<f64>) -> f64 {
        use faer::linalg::solvers::Solve as _;
        let Some(factor) = self.factor(variation) else { return f64::NEG_INFINITY };
        let solved = factor.solve(scatter);
        let windows = scatter.ncols();
        let quadratic: f64 =
            (0..windows).map(|c| (0..self.len).map(|k| scatter[(k, c)] * solved[(k, c)]).sum::<f64>()).sum();
        let l = factor.L();
        let log_det: f64 = (0..self.len).map(|i| l[(i, i)].ln()).sum();
        -0.5 * quadratic - (windows - 1) as f64 * log_det
    }
}

fn add_outer(target: &mut Mat<f64>, column: &Mat<f64>) {
    *target += column * column.transpose();
}

/// Deviations of residual windows from their mean, as columns.
pub fn scatter(residuals: &[Vec<f64>]) -> Mat<f64> {
    let mean = crate::signal::mean_of(residuals);
    Mat::from_fn(mean.len(), residuals.len(), |k, c| residuals[c][k] - mean[k])
}

/// Steps of the search, as factors: of everything but the noise, which could stand in for everything and would then not be
/// called back, and of all sizes.
const OWN_FACTORS: [f64; 2] = [3.0, 1.6];
const FACTORS: [f64; 4] = [3.0, 1.6, 1.25, 1.1];
/// Most rounds with one factor: parts that resemble one another give way in turn.
const ROUNDS: usize = 3;
/// A round that gains less than this, nats, was the last with its factor.
const WORTH_ANOTHER: f64 = 1.0;

/// Sizes that make the scatter of windows recorded by `sensor` most probable: one at a time, by shrinking factors.
pub fn estimate(passages: &[(&Shapes, Mat<f64>)], sensor: &Sensor) -> Variation {
    let mut range = Variation::RANGE;
    range[0][1] = most_noise_m_s2(sensor);
    let mut search = Search::new(passages, range);
    search.sweep(&OWN_FACTORS, 1);
    search.sweep(&FACTORS, 0);
    Variation::of_values(search.best)
}

fn most_noise_m_s2(sensor: &Sensor) -> f64 {
    Variation::RANGE[0][1].max(MOST_NOISE * stated_noise_m_s2(sensor))
}

/// Search for the sizes of the parts.
struct Search<'a> {
    passages: &'a [(&'a Shapes, Mat<f64>)],
    range: [[f64; 2]; PARTS],
    best: [f64; PARTS],
    highest: f64,
}

impl<'a> Search<'a> {
    fn new(passages: &'a [(&'a Shapes, Mat<f64>)], range: [[f64; 2]; PARTS]) -> Self {
        let mut search = Self { passages, range, best: Variation::START.values(), highest: 0.0 };
        search.highest = search.log_likelihood(search.best);
        search
    }

    fn log_likelihood(&self, values: [f64; PARTS]) -> f64 {
        use rayon::prelude::*;
        let variation = Variation::of_values(values);
        sum_in_order(
            self.passages.par_iter().map(|(shapes, scatter)| shapes.log_likelihood(&variation, scatter)),
        )
    }

    /// Rounds over the parts from `first` on, with each factor in turn.
    fn sweep(&mut self, factors: &[f64], first: usize) {
        for factor in factors {
            for _ in 0..ROUNDS {
                let before = self.highest;
                for part in first..PARTS {
                    // What grows need not be tried smaller.
                    let _ = self.walk(part, *factor) || self.walk(part, 1.0 / factor);
                }
                if self.highest - before < WORTH_ANOTHER {
                    break;
                }
            }
        }
    }

    /// Multiplies one size by `step` as long as that helps; whether it did.
    fn walk(&mut self, part: usize, step: f64) -> bool {
        let [least, most] = self.range[part];
        let mut moved = false;
        loop {
            let mut candidate = self.best;
            candidate[part] = (candidate[part] * step).clamp(least, most);
            if candidate == self.best {
                return moved;
            }
            let found = self.log_likelihood(candidate);
            if found <= self.highest {
                return moved;
            }
            (self.best, self.highest, moved) = (candidate, found, true);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::passage::random::Random;
    use crate::recording::read_site;
    use crate::signal::brick_band;

    const LEN: usize = 128;
    const WINDOWS: usize = 6;

    /// A bogie whose wheels excite waves that differ by axle and kind; the slope and curvature are those of a shifted wave.
    fn responses(grids: &PathSplines) -> (BogieResponses, [WheelMoves; 2]) {
        let wave = |amplitude: f64, f_hz: f64, phase: f64| -> Vec<f64> {
            (0..LEN)
                .map(|k| amplitude * (std::f64::consts::TAU * f_hz * k as f64 / RATE_HZ + phase).sin())
                .collect()
        };
        let mut out = BogieResponses::without_path(LEN, grids.len());
        let late = [0.0, 1.3];
        out.load = late.map(|late| [wave(8.0, 20.0, late), wave(5.0, 31.0, late)]);
        let moves = late.map(|late| WheelMoves {
            depth: wave(12.0, 70.0, late),
            shift: wave(600.0, 130.0, late + 0.4),
            curvature: wave(2.0e4, 180.0, late),
        });
        (out, moves)
    }

    /// Deviations of the windows of a train whose wheels differ by known sizes.
    fn drawn(
        r: &BogieResponses,
        moves: &[WheelMoves; 2],
        truth: &Variation,
        random: &mut Random,
    ) -> Mat<f64> {
        let windows: Vec<Vec<f64>> = (0..WINDOWS)
            .map(|_| {
                let white: Vec<f64> = (0..LEN).map(|_| random.normal()).collect();
                // White over the band: RMS 1 after the rest is cut off.
                let scale = truth.noise_m_s2 * (0.5 * RATE_HZ / 275.0).sqrt();
                let mut window: Vec<f64> =
                    brick_band(&white, RATE_HZ, 0.0, 275.0).iter().map(|v| scale * v).collect();
                for axle in 0..2 {
                    let [c, s] = &r.load[axle];
                    let m = &moves[axle];
                    let (load, side) = (truth.load * random.normal(), truth.side_load * random.normal());
                    let (depth, shift) = (truth.depth * random.normal(), truth.shift_m * random.normal());
                    for (k, value) in window.iter_mut().enumerate() {
                        *value += c[k] * (load + side) + s[k] * (load - side) + depth * m.depth[k];
                        *value += shift * m.shift[k] + 0.5 * shift * shift * m.curvature[k];
                    }
                }
                window
            })
            .collect();
        scatter(&windows)
    }

    #[test]
    fn property_sizes_are_found_again_in_drawn_windows() {
        let grids = PathSplines::level(3.4, [0.055, 0.11]);
        let (r, moves) = responses(&grids);
        let shapes = Shapes::new(&r, moves, &OwnIrregularity::new(&grids), &SensorModel::default());
        let truth = Variation {
            noise_m_s2: 0.04,
            load: 0.02,
            side_load: 0.01,
            depth: 0.05,
            shift_m: 0.01,
            own_m: 0.0,
            own_stock_m: 0.0,
        };
        let mut random = Random::new(5, 1);
        let passages: Vec<(&Shapes, Mat<f64>)> =
            (0..16).map(|_| (&shapes, drawn(&r, &shapes.moves, &truth, &mut random))).collect();
        let dir = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data/field/reference-2");
        let found = estimate(&passages, &read_site(&dir).unwrap().crossing.sensor);
        for (name, found, truth) in [
            ("noise", found.noise_m_s2, truth.noise_m_s2),
            ("load", found.load, truth.load),
            ("side load", found.side_load, truth.side_load),
            ("depth", found.depth, truth.depth),
            ("shift", found.shift_m, truth.shift_m),
        ] {
            assert!((found / truth).ln().abs() < 0.25, "{name}: {found} instead of {truth}");
        }
    }

    #[test]
    fn analytic_noise_of_a_band_is_one_at_lag_nought_and_falls_off() {
        let r = band_noise(LEN, &SensorModel::default());
        assert!((r[0] - 1.0).abs() < 1e-12);
        // White to 250 Hz and 3/8 of the squared taper's 50 Hz: sin(x)/x with x = pi 268.75/400 at lag 1.
        let x = std::f64::consts::PI * 268.75 / 400.0;
        assert!((r[1] - x.sin() / x).abs() < 2e-3, "{}", r[1]);
        assert!(r[LEN - 1].abs() < 0.01);
    }
}
