//! Intervals of what is averaged over the wheels of a site: mean force peak, mean RMS of the irregularity, mean irregularity.
//!
//! An average over hundreds of wheels is rid of what differs from wheel to wheel. What stays is what they share: the common force
//! profile, of which one sensor cannot tell all; the ballast, which makes the force of a recording and the rail's deflection
//! under it; the position; and how well path and force go together at all. How the trains that came differ from those that did not
//! is counted from their scatter.

use faer::Mat;

use crate::analysis::{Indicators, PassageResult, WheelsetResult, explained};
use crate::forces::{SharedCauses, Spread, deviations, position_sd_m, slope_per_m};
use crate::identify::IdentifiedSite;
use crate::interaction::{Interaction, Wheelset};
use crate::inverse::hierarchy::kinds;
use crate::irregularity::{compression_slope_m_n, in_band_matrix, on_grid_matrix};
use crate::recording::Vehicle;
use crate::signal::{mean, mean_of, nearest, one_at};

/// How far the path behind the forces, as a whole, may be deeper or flatter than a laser scan of it, relative: on recordings of
/// another program its depth is 1.01, 0.89 and 0.96 of the scan's, and 1.03, 0.90 and 0.95 by the true forces on the true ballast,
/// which none of the other causes accounts for.
const DEPTH_SD: f64 = 0.07;

/// Standard deviations of averages over the wheels that the model explains.
#[derive(Clone, Debug, PartialEq)]
pub struct MeanErrors {
    /// Of the mean force peak, newtons.
    pub peak_force_n: f64,
    /// Of the mean RMS of the irregularity, metres.
    pub irregularity_rms_m: f64,
    /// Of the mean irregularity on the result grid, metres.
    pub irregularity_m: Vec<f64>,
}

/// Calibrated track and the same with each entry of the ballast's vector moved by a step.
pub struct Tracks<'a> {
    /// Calibrated.
    pub calibrated: &'a Interaction,
    /// Moved, and the step.
    pub moved: &'a [(Interaction, f64)],
}

/// What moves results on a grid of all wheels of one kind alike: a row per place on the grid.
struct Moves {
    /// A column per entry of the common profile.
    profile: Mat<f64>,
    /// A column per entry of the ballast's vector.
    ballast: Mat<f64>,
}

/// Force and irregularity of one axle of a group, in one class of speeds.
struct OfAxle {
    force_n: Moves,
    irregularity_m: Moves,
}

/// Wheels that share a class of speeds, a kind of group and a place in it.
struct Alike<'a> {
    class: usize,
    moves: OfAxle,
    wheels: Vec<&'a WheelsetResult>,
}

/// Errors of the averages over a site, which `means` holds.
pub fn mean_errors(
    (site, spreads): (&IdentifiedSite, &[Spread]),
    tracks: &Tracks,
    passages: &[PassageResult],
    means: &Indicators,
) -> MeanErrors {
    let grid_m = &means.position_m;
    let used = explained(passages);
    let wheels = used.iter().map(|p| p.wheelsets.len()).sum();
    let groups = alike((site, spreads), tracks, &used, grid_m);
    let average = Average { site, groups: &groups, wheels };
    let at_peak = |w: &WheelsetResult| one_at(nearest(grid_m, w.peak_position_m), grid_m.len());
    let of_rms = |w: &WheelsetResult| {
        let scale = 1.0 / (w.irregularity_rms_m.max(f64::MIN_POSITIVE) * grid_m.len() as f64);
        w.irregularity_m.iter().map(|z| scale * z).collect()
    };
    let of = |value: &dyn Fn(&WheelsetResult) -> f64| scatter(&used, value);
    let irregularity: Vec<f64> = means.mean_irregularity_m.iter().map(|z| z.value).collect();
    // The lag is a time, and every class of speeds has its own distance for it.
    let position_sd_m = mean(&spreads.iter().map(|s| position_sd_m(site, s.passage)).collect::<Vec<_>>());
    let shifted_m = slope_per_m(grid_m, &irregularity);
    let curve = average.curve().into_iter().zip(shifted_m).enumerate();
    let together = |parts: &[f64]| parts.iter().map(|p| p.powi(2)).sum::<f64>().sqrt();
    MeanErrors {
        peak_force_n: together(&[average.of(|moves| &moves.force_n, at_peak), of(&|w| w.peak_force_n.value)]),
        irregularity_rms_m: together(&[
            average.of(|moves| &moves.irregularity_m, of_rms),
            DEPTH_SD * means.irregularity_rms_m.mean,
            of(&|w| w.irregularity_rms_m),
        ]),
        irregularity_m: curve
            .map(|(i, (sd, slope))| {
                let scattered = of(&|w| w.irregularity_m[i]);
                together(&[sd, slope * position_sd_m, DEPTH_SD * irregularity[i], scattered])
            })
            .collect(),
    }
}

/// Averages over all wheels of a site.
struct Average<'a> {
    site: &'a IdentifiedSite<'a>,
    groups: &'a [Alike<'a>],
    wheels: usize,
}

impl Average<'_> {
    /// Standard deviation of the mean of a number per wheel that changes with its results by weights over the grid.
    fn of(&self, moves: impl Fn(&OfAxle) -> &Moves, weights: impl Fn(&WheelsetResult) -> Vec<f64>) -> f64 {
        let row = |group: &Alike| {
            let sum = mean_of(&group.wheels.iter().map(|w| weights(w)).collect::<Vec<_>>());
            Mat::from_fn(1, sum.len(), |_, i| sum[i])
        };
        self.deviations(|group| {
            let (row, moves) = (row(group), moves(&group.moves));
            Moves { profile: &row * &moves.profile, ballast: &row * &moves.ballast }
        })
        .first()
        .copied()
        .unwrap_or(0.0)
    }

    /// Standard deviation of the mean irregularity on the grid.
    fn curve(&self) -> Vec<f64> {
        self.deviations(|group| {
            let moves = &group.moves.irregularity_m;
            Moves { profile: moves.profile.clone(), ballast: moves.ballast.clone() }
        })
    }

    /// Standard deviations of means over all wheels, given how those of every group move. The profiles of classes are independent, the
    /// ballast is one.
    fn deviations(&self, of_group: impl Fn(&Alike) -> Moves) -> Vec<f64> {
        let mut classes: Vec<Option<Mat<f64>>> = vec![None; self.site.classes.len()];
        let mut ballast: Option<Mat<f64>> = None;
        for group in self.groups {
            let share = faer::Scale(group.wheels.len() as f64 / self.wheels.max(1) as f64);
            let moves = of_group(group);
            add(&mut classes[group.class], share * moves.profile);
            add(&mut ballast, share * moves.ballast);
        }
        let known = &self.site.ballast.covariance;
        let of_class = |(class, moves): (usize, &Option<Mat<f64>>)| {
            let covariance = self.site.classes[class].profile_covariance();
            moves.as_ref().map(|m| deviations(m, &(m * covariance)))
        };
        let parts = classes.iter().enumerate().filter_map(of_class);
        let parts: Vec<Vec<f64>> = parts.chain(ballast.map(|m| deviations(&m, &(&m * known)))).collect();
        let count = parts.first().map_or(0, Vec::len);
        (0..count).map(|i| parts.iter().map(|p| p[i].powi(2)).sum::<f64>().sqrt()).collect()
    }
}

fn add(sum: &mut Option<Mat<f64>>, part: Mat<f64>) {
    match sum {
        Some(sum) => *sum += part,
        None => *sum = Some(part),
    }
}

/// Wheels of passages by class, kind of group and place in it, with what moves them alike.
fn alike<'a>(
    (site, spreads): (&IdentifiedSite, &[Spread]),
    tracks: &Tracks,
    passages: &[&'a PassageResult],
    grid_m: &[f64],
) -> Vec<Alike<'a>> {
    let kinds = kinds(&site.pattern);
    let mut groups = Vec::new();
    for (class, spread) in spreads.iter().enumerate() {
        let members: Vec<&PassageResult> =
            passages.iter().copied().filter(|p| site.class_of(p.speed_m_s) == class).collect();
        if members.is_empty() {
            continue;
        }
        let class_moves = OfClass::new(site, spread, tracks, grid_m);
        for (kind, axles) in kinds.iter().zip(spread.shared()) {
            for (axle, shared) in axles.iter().enumerate() {
                let is_one = |w: &&WheelsetResult| kind.groups.iter().any(|g| g.first + axle == w.wheelset);
                let wheels: Vec<_> = members.iter().flat_map(|p| &p.wheelsets).filter(is_one).collect();
                if !wheels.is_empty() {
                    groups.push(Alike { class, moves: class_moves.of_axle(axle, shared), wheels });
                }
            }
        }
    }
    groups
}

/// What the axles of a class of speeds have in common.
struct OfClass<'a> {
    vehicle: &'a Vehicle,
    static_force_n: f64,
    calibrated: Wheelset,
    moved: Vec<(Wheelset, f64)>,
    /// From samples to the result grid.
    to_grid: Mat<f64>,
    /// The same in the band of the irregularity.
    to_band: Mat<f64>,
}

impl<'a> OfClass<'a> {
    fn new(site: &'a IdentifiedSite, spread: &Spread, tracks: &Tracks, grid_m: &[f64]) -> Self {
        let (position_m, index) = (&spread.position_m, spread.passage);
        let wheelset = |i: &Interaction| i.wheelset(position_m, site.direction, site.static_force_n[index]);
        let calibrated = wheelset(tracks.calibrated);
        let to_grid = on_grid_matrix(position_m, grid_m);
        let band = in_band_matrix(position_m.len(), calibrated.rate_hz, site.timings[index].speed_m_s);
        Self {
            vehicle: &site.site.crossing.vehicle,
            static_force_n: site.track.load_factor[0] * site.static_force_n[index],
            calibrated,
            moved: tracks.moved.iter().map(|(interaction, step)| (wheelset(interaction), *step)).collect(),
            to_band: &to_grid * band,
            to_grid,
        }
    }

    fn of_axle(&self, axle: usize, shared: &SharedCauses) -> OfAxle {
        let leading = axle.is_multiple_of(2);
        let compliance: Vec<f64> =
            shared.base_n.iter().map(|f| compression_slope_m_n(*f, self.vehicle)).collect();
        let path_m = |change_n: &Mat<f64>| {
            let mut path = self.calibrated.path_change_m(change_n);
            for j in 0..path.ncols() {
                for i in 0..path.nrows() {
                    path[(i, j)] -= compliance[i] * change_n[(i, j)];
                }
            }
            path
        };
        let deviation_n = Mat::from_fn(shared.base_n.len(), 1, |i, _| shared.base_n[i] - self.static_force_n);
        let under = |w: &Wheelset| w.relative_path_m(leading, &deviation_n);
        let mut by_ballast = path_m(&shared.ballast_n);
        let calibrated = under(&self.calibrated);
        for (k, (moved, step)) in self.moved.iter().enumerate() {
            let change = under(moved) - &calibrated;
            for i in 0..change.nrows() {
                by_ballast[(i, k)] += change[(i, 0)] / step;
            }
        }
        OfAxle {
            force_n: Moves {
                profile: &self.to_grid * &shared.profile,
                ballast: &self.to_grid * &shared.ballast_n,
            },
            irregularity_m: Moves {
                profile: &self.to_band * path_m(&shared.profile),
                ballast: &self.to_band * by_ballast,
            },
        }
    }
}

/// Standard deviation of a mean over wheels by what differs from wheel to wheel or, where that is more, from train to train.
fn scatter(passages: &[&PassageResult], value: &dyn Fn(&WheelsetResult) -> f64) -> f64 {
    let of_passage = |p: &&PassageResult| p.wheelsets.iter().map(value).collect::<Vec<f64>>();
    let by_passage: Vec<Vec<f64>> = passages.iter().map(of_passage).filter(|v| !v.is_empty()).collect();
    let means: Vec<f64> = by_passage.iter().map(|v| mean(v)).collect();
    of_mean(&means).max(of_mean(&by_passage.concat()))
}

/// Standard deviation of the mean of independent values by their scatter; of one, nothing is known.
fn of_mean(values: &[f64]) -> f64 {
    if values.len() < 2 {
        return 0.0;
    }
    let (m, n) = (mean(values), values.len() as f64);
    (values.iter().map(|v| (v - m).powi(2)).sum::<f64>() / (n - 1.0) / n).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::examples::{passage, wheelset};
    use crate::forces::WheelForce;
    use crate::identify::identify;
    use crate::irregularity::irregularity_of_wheelset;
    use crate::pipeline::interactions;
    use crate::progress::Silent;
    use crate::recording::read_site;
    use crate::signal::rms;

    /// A train of wheels with these peaks, newtons.
    fn train(peaks_n: &[f64]) -> PassageResult {
        passage(peaks_n.iter().enumerate().map(|(i, peak)| wheelset(i, *peak, 0.0, &[])).collect())
    }

    fn of(trains: &[PassageResult]) -> f64 {
        scatter(&trains.iter().collect::<Vec<_>>(), &|w| w.peak_force_n.value)
    }

    /// Root mean square of a difference over that of the second.
    fn off(found: &[f64], expected: &[f64]) -> f64 {
        let difference: Vec<f64> = found.iter().zip(expected).map(|(a, b)| a - b).collect();
        rms(&difference) / rms(expected)
    }

    /// By the whole chain from a force on a track to an irregularity, with the force, the track or both moved.
    #[test]
    fn property_moves_are_the_differences_between_irregularities() {
        let dir = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data/field/reference-1");
        let mut site = read_site(&dir).unwrap();
        site.passages.truncate(3);
        let identified = identify(&site, &Silent).unwrap();
        let spread = Spread::new(&identified, 0).unwrap();
        let (calibrated, moved) = interactions(&identified);
        let grid_m: Vec<f64> = (0..=240).map(|i| -0.9 + 0.01 * f64::from(i)).collect();
        let tracks = Tracks { calibrated: &calibrated, moved: &moved };
        let class = OfClass::new(&identified, &spread, &tracks, &grid_m);
        let shared = &spread.shared()[0][0];
        let moves = class.of_axle(0, shared).irregularity_m;
        let speed_m_s = identified.timings[spread.passage].speed_m_s;
        let path = |wheelset: &Wheelset, by_n: &dyn Fn(usize) -> f64| {
            let force_n = shared.base_n.iter().enumerate().map(|(i, f)| f + by_n(i)).collect();
            let force = WheelForce::given(0, spread.position_m.clone(), force_n);
            let vehicle = &site.crossing.vehicle;
            irregularity_of_wheelset(&force, speed_m_s, class.static_force_n, wheelset, vehicle, &grid_m)
        };
        let calibrated = path(&class.calibrated, &|_| 0.0);
        let per = |moved: Vec<f64>, step: f64| -> Vec<f64> {
            moved.iter().zip(&calibrated).map(|(a, b)| (a - b) / step).collect()
        };
        for (k, (wheelset, step)) in class.moved.iter().enumerate() {
            let found = per(path(wheelset, &|i| step * shared.ballast_n[(i, k)]), *step);
            assert!(
                off(moves.ballast.col_as_slice(k), &found) < 0.05,
                "{k}: {}",
                off(moves.ballast.col_as_slice(k), &found)
            );
        }
        for entry in [0, shared.profile.ncols() / 2] {
            let step = 0.01 * class.static_force_n / shared.profile.col(entry).norm_max();
            let found = per(path(&class.calibrated, &|i| step * shared.profile[(i, entry)]), step);
            assert!(
                off(moves.profile.col_as_slice(entry), &found) < 0.02,
                "{entry}: {}",
                off(moves.profile.col_as_slice(entry), &found)
            );
        }
    }

    /// Wheels that differ within trains alike: their own scatter over the root of their number. Trains that differ and whose wheels do
    /// not: that of the trains.
    #[test]
    fn analytic_scatter_of_wheels_or_of_trains() {
        let alike = [train(&[1.0, 2.0, 3.0, 4.0]), train(&[4.0, 3.0, 2.0, 1.0])];
        let expected = (8.0 * 1.25_f64 / 7.0 / 8.0).sqrt();
        assert!((of(&alike) - expected).abs() < 1e-12, "{}", of(&alike));
        let apart = [train(&[1.0; 4]), train(&[3.0; 4])];
        assert!((of(&apart) - 1.0).abs() < 1e-12, "{}", of(&apart));
        assert_eq!(of(&[train(&[5.0])]), 0.0);
        assert_eq!(of(&[]), 0.0);
    }
}
