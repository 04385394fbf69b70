//! Tolerances of the whole-system tests, each with its reason.

/// Speed of a field recording against the truth, relative, median of a site. Three times what was measured; the
/// force estimate needs 1e-3.
pub const SPEED_MEDIAN: f64 = 3e-4;
/// The same for the worst recording.
pub const SPEED_LARGEST: f64 = 1e-3;
/// Speed against the operator's, relative: his is within 1 %, plus our own error.
pub const SPEED_OPERATOR: f64 = 1.05e-2;

/// Synthetic train, noise 0.02 m/s²: speed, relative.
pub const SYNTHETIC_SPEED: f64 = 1e-4;
/// Times of axles, s: 2 mm of track at 40 m/s.
pub const SYNTHETIC_TIME_S: f64 = 5e-5;
/// Forces, relative: interpolation of the window and of the peak, 1e-3 each.
pub const SYNTHETIC_FORCE: f64 = 2e-3;
/// Position of the peak, m: a fifth of the grid's step.
pub const SYNTHETIC_POSITION_M: f64 = 4e-3;

/// A field site with known truth, force peak of every wheelset, relative, median and 90th percentile: what a decision
/// about maintenance needs.
pub const PEAK_MEDIAN: f64 = 0.025;
/// The same, 90th percentile.
pub const PEAK_P90: f64 = 0.05;
/// Force peak of one recording at two sampling rates, relative: a tenth of the peaks' error, for noise above the band that is no more.
pub const OTHER_RATE: f64 = 1e-3;
/// The same number by another order of operations, relative.
pub const ROUNDING: f64 = 1e-12;
/// Median force peak error of reference-1 where the damping of the ballast is described wrong: 1.9 to 2.4 %, as it is found 5 % too high.
pub const PEAK_ON_FOUND_DAMPING: f64 = 0.035;
/// Force peaks of few simulated trains, eight of two speeds or six of one car, relative, median: twice what was measured at two speeds.
pub const PEAK_OF_FEW_TRAINS: f64 = 0.01;
/// Peaks of trains whose deflection drowns in noise, and how many are inside: 34 % and a third where each train is placed by itself.
pub const PEAK_UNDER_NOISE: f64 = 0.05;
pub const INSIDE_UNDER_NOISE: f64 = 0.8;
/// Waveforms of two slow trains: 0.23 where they are not placed together.
pub const WAVEFORM_OF_TWO_SLOW_TRAINS: f64 = 0.12;
/// Waveforms where the crossing part ends within elements: 0.02 here, 0.09 where each of these was of one kind as a whole.
pub const WAVEFORM_BESIDE_NODES: f64 = 0.03;
/// Waveforms of trains of 28 m/s over a transition between two knots, and how many of their samples are inside: 0.03 and 0.9 here, 0.07 to 0.16
/// and 0.56 to 0.8 with knots 0.1 m apart.
pub const WAVEFORM_OF_SLOW_TRAINS: f64 = 0.05;
pub const INSIDE_OF_SLOW_TRAINS: f64 = 0.85;
/// Stiffness of soft ballast, relative: 1 % here, more than twice too stiff where the calibration begins with stiff ballast.
pub const P1_ON_SOFT_BALLAST: f64 = 0.05;
/// Curves and p1 over next to no support, relative: 5 and 4 % here, 7 and 6 % with another seed, as the shape p3, 0.1, is three standard
/// deviations off its prior; a calibration that ends too early leaves 19 and 28 %.
pub const WAVEFORM_ON_NO_SUPPORT: f64 = 0.1;
pub const P1_ON_NO_SUPPORT: f64 = 0.12;
/// Force peak of a recording with more quiet track around the train, relative: bias and noise are those of other samples.
pub const LONGER_RECORDING: f64 = 2e-3;
/// Force peaks over a void of 0.8 mm whose size is a quarter wrong where it is taken into account, relative, median: what is asked of a
/// site without one, twice over.
pub const VOID_PEAK_MEDIAN: f64 = 0.05;
/// p1 and p2 found below a void in recordings of another program, logarithm: 26 to 39 for 30 and 13.7 to 17.6 for 18 MN/m², by where the fit
/// begins (0.7 to 0.9 mm), are 0.14, 0.26, 0.27 and 0.02; a void under three sleepers, bogie by bogie, leaves 1.0 to 1.3 of p1.
pub const BALLAST_BELOW_A_VOID: f64 = 0.4;
/// Peaks and waveform over a bed that is not linear where that is taken into account, part of their errors where it is not: three tenths
/// was measured.
pub const BED_PART: f64 = 0.5;
/// Peaks where a transferred load is taken into account, a tenth too small, part of their errors where it is not: a seventh was measured.
pub const TRANSFER_PART: f64 = 0.3;
/// Errors of peaks and waveforms where steps of the baseline were taken off the recordings, over those of the recordings without steps: 1.1 and
/// 1.7 were measured, 18 to 31 with the steps.
pub const WITHOUT_STEPS: f64 = 2.0;
/// Position of the peak, median, m: a shorter distance than a grinder works on.
pub const PEAK_POSITION_M: f64 = 0.03;
/// Share of the laser scan inside the 90 % interval of the mean irregularity; 1.00, 0.71 and 1.00 are reached. Errors
/// along a curve hang together, so that one site's share may be far from 0.9.
pub const SCAN_COVERED: f64 = 0.6;
/// Mean irregularity against the laser scan, RMS over peak to peak: what is asked of the method.
pub const IRREGULARITY: f64 = 0.04;
/// What is asked of the method on stiff and on soft pads: force peak, relative, 90th percentile; waveform, RMS over peak to peak,
/// median.
pub struct Asked {
    pub peak_p90: f64,
    pub waveform: f64,
}
pub const STIFF_PADS: Asked = Asked { peak_p90: 0.015, waveform: 0.02 };
pub const SOFT_PADS: Asked = Asked { peak_p90: 0.019, waveform: 0.04 };
/// Force peak, relative, median: measured 0.0075, 0.0065, 0.0054; posteriors expect 0.0054 to 0.0088.
pub const PEAK_MEDIAN_REACHED: f64 = 0.0085;
/// Position of the impact, m, median: what is asked of the method.
pub const IMPACT_M: f64 = 0.01;
/// Speed, relative: what is asked of the method.
pub const SPEED_ASKED: f64 = 5e-4;
/// Shares of true peaks and samples inside 90 % intervals: 0.85 to 0.95 is asked; all wheels of a site share most of
/// the error, so that a site has up to 0.98 by chance.
pub const COVERED: [f64; 2] = [0.85, 0.99];
/// Time by which all forces of a site come late, s: twice what intervals allow for (standard deviation).
pub const LATE_S: f64 = 200e-6;
/// Ballast away from the crossing, relative: what is asked of the method.
pub const P1: f64 = 0.07;
/// Ballast under the crossing, relative: what is asked of the method.
pub const P2: f64 = 0.03;
/// Speed of a train, relative: 90th percentile of a site, all of a simulated one.
pub const SITE_SPEED: f64 = 1e-3;
/// Sleeper displacement, RMS over peak to peak, median of the passages: measured 0.0078, 0.0093, 0.0071.
pub const DISPLACEMENT: f64 = 0.01;
/// The node's force peaks against the host's from the same recordings, relative, median: twice what was measured and more, a part of
/// what either is off.
pub const NODE_AGAINST_HOST: f64 = 0.005;
/// The same, mean with its sign, on a panel where the node was 0.0029 low: measured 0.0001, and at most 0.0014 on 34 sites.
pub const NODE_BIAS_AGAINST_HOST: f64 = 0.0015;
/// Width of the node's intervals over that of the host's: it has fewer samples and blends speeds.
pub const NODE_WIDTH: (f64, f64) = (0.9, 1.2);
/// Part of the true peaks inside the node's 90 % intervals: the host's hold 89 % on that site.
pub const NODE_COVERAGE: f64 = 0.83;
/// Where the node sees an axle, against the host, 90th percentile, m: its peak moves by as much.
pub const NODE_AXLE_M: f64 = 0.03;

/// Waveform error of the paper's rule over that of the evidence estimate at 1 % noise: measured 15 to 18.
pub const PAPER_TO_EVIDENCE: f64 = 8.0;
/// Peak error of the paper's chain over that of the chain in between on recordings: measured 4 to 9.
pub const PAPER_TO_BETWEEN: f64 = 2.0;
/// Mean peak error of a site over the posterior's standard deviation of what its wheels share: a normal one is beyond once in
/// 370 sites.
pub const SHARED_SDS: f64 = 3.0;
/// Median peak error of a site over that which the posterior expects: the part that all wheels share is one draw.
pub const PEAK_TO_EXPECTED: f64 = 2.0;
/// Displacement error of a high-pass at 0.8-1.5 Hz, RMS over peak to peak: measured 16 to 18 %.
pub const HIGH_PASS_LOSS: f64 = 0.1;
/// The same with the model below 3 Hz: measured 0.8-0.9 %.
pub const MODEL_BELOW_3_HZ: f64 = 0.02;

/// Evidence against the density by the covariance's own factor, relative to the sum of squares: rounding.
pub const DENSITY: f64 = 1e-6;
/// Linearity of the estimate, newtons: rounding of sums of some 10⁵ N.
pub const LINEAR_N: f64 = 1e-4;
/// Explained plus remaining variance against the prior's: rounding, amplified by the condition of the covariance.
pub const VARIANCE: f64 = 1e-5;

/// Passage simulation with reduced sleepers against all degrees of freedom, RMS below 250 Hz, contact force and sensor
/// acceleration: measured 9e-5 and 4e-4, with five modes instead of six 4e-4 and 6e-3.
pub const REDUCTION: f64 = 1e-3;

/// `closed_fraction` from `predictions.parquet` against `diagnosis.json`: what the contract allows.
pub const CLOSED_FRACTION: f64 = 0.01;

/// Part of the gap that voids close on recordings of another program: 0.99; 0.92 under three sleepers and bogie by bogie.
pub const VOID_CLOSED: f64 = 0.95;
/// Part of the gap that voids of 4.5 mm close at least: three seeds of the case study reach 0.95 to 0.99.
pub const DEEP_VOID_CLOSED: f64 = 0.9;
/// Part of the gap that a mount closes beside recordings that clip: 1.01, and 0.93 by the clipping alone.
pub const MOUNT_BESIDE_CLIPPING_CLOSED: f64 = 0.97;
/// Part of the gap that a dip in the stock rail and moving ballast close together: 1.02, and 0.19 by what is found one by one.
pub const TOGETHER_CLOSED: f64 = 0.95;
/// The same beside a dip so deep that wheels jump off it, where a step of 0.01 m of its place still shows: 0.95 with nine passages, nothing
/// without both.
pub const DEEP_DIP_CLOSED: f64 = 0.9;
/// Part of the gap that a light mount closes: 1.00; 0.88 with passages a wave from their places.
pub const LIGHT_MOUNT_CLOSED: f64 = 0.95;
/// Part of the gap that steps of the baseline and a stiffening ballast close: 1.00, and 0.93 by the steps alone.
pub const BESIDE_STEPS_CLOSED: f64 = 0.97;
/// The same of steps and a void of 2.2 mm: 0.92, and 0.68 by the void alone.
pub const STEPS_BESIDE_VOIDS_CLOSED: f64 = 0.85;
/// Part of the gap that flats of 63 mm close: 0.7; without bound they were withdrawn.
pub const FLATS_CLOSED: f64 = 0.4;
/// Length of flats, relative: −3 to +5 % on four sites of trials, −21 % on one beside a mount.
pub const FLAT_LENGTH: f64 = 0.12;
/// Amplitude of waves of wheels, relative: −4 to +3 % on 18 sites of trials; the linear response makes them up to 47 % too high.
pub const WAVE_AMPLITUDE: f64 = 0.08;
/// Part of the gap that waves or hollow wheels and the mount beside them close: 0.97 and 0.93; without the wheels 0.91 of a gap that ends
/// higher.
pub const WHEELS_BESIDE_A_MOUNT_CLOSED: f64 = 0.85;
/// Share of the wheels that have them: 0.3, 0.4, 0.5 and 0.7 are told apart.
pub const FLAT_SHARE: f64 = 0.11;
/// Gap of known-wheel-out-of-roundness with its waves in the model: 0.173; 0.217 where the ends of windows were deflections.
pub const WAVES_GAP: f64 = 0.19;
/// Size and decay of steps of the baseline, relative: found to 1.5 % where nothing else is wrong with the model.
pub const STEP_SIZE_AND_DECAY: f64 = 0.04;

/// Gaps from `predictions.parquet` against `diagnosis.json`, relative: rounding of sums of some 10⁴ squares.
pub const GAP_RECOMPUTED: f64 = 1e-9;
/// A number of `diagnosis.json` as it is read again, relative: the last digit.
pub const THROUGH_JSON: f64 = 1e-14;
/// The gap of a fit whose sums are taken in another order, relative: rounding, amplified by the steps of a search.
pub const SUM_ORDER: f64 = 1e-3;

/// Pads found on a simulated site without any effect, ln k: measured -0.06 with a standard deviation of 0.05; -0.47 before
/// wheels rolled over a blurred path. An effect of this size would be named.
pub const PADS_OF_NOTHING: f64 = 0.25;
/// Their gain in log evidence, nats: measured -1.4, before 67.
pub const GAIN_OF_NOTHING: f64 = 5.0;
/// Place of a passage of reference-2 that had been put 20 cm off, m: a sample at 800 Hz is 6 cm there, its parabola far less.
pub const FOUND_AGAIN_M: f64 = 0.01;
/// Spread of the wheels' shifts against what they were drawn from, relative: measured -0.12; some 130 wheels scatter by 0.06.
pub const SHIFT: f64 = 0.2;
/// Model against the simulator of the trials where wheels are alike, RMS of the mean window relative to the signal: measured
/// 0.0029, noise included.
pub const ALIKE_WHEELS: f64 = 0.01;
/// Force peak of a train beside others that are left out, relative: the same arithmetic on the same recordings.
pub const BESIDE_OTHERS: f64 = 1e-9;
/// Depth of hollow wheels, relative: −10 to +1 % on seven sites of trials, four of them over voids or ballast that stiffens, and −22 %
/// on one over the deepest void; by the linear response and a look in simulated wheels +34 and +30 % on two of them.
pub const HOLLOW_DEPTH: f64 = 0.15;

/// Part of the true peaks inside their 90 % intervals on a sleeper whose seats and sensor lie between the steps of the mesh: measured 1.00 with 16
/// trains, with longer elements 0.53.
pub const INSIDE_ON_ANY_SLEEPER: f64 = 0.85;
