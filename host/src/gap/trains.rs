//! How trains differ as a whole: the wheels of one train resemble one another where they were turned together, and no model of the
//! panel can know how deep they run.
//!
//! The scatter of the bogies about their train's mean does not hold it, so that the floor needs it besides: the part of the variance
//! between trains that is more than the wheels of a train make of their mean, and that goes neither with speed nor with temperature,
//! as what a model lacks may.

use rayon::prelude::*;

use super::data::Observed;
use super::measure::{Prediction, displacement};
use super::variation::Shapes;
use crate::signal::{dot, freed, mean};

/// Squares between trains over those of their means by chance from which on trains differ: of 120 simulated sites of 16 passages, whose
/// trains do not, none reaches 2.4.
const BEYOND_CHANCE: f64 = 2.5;

/// What all wheels of a train that run deeper add to what the sensor shows.
#[derive(Clone, Debug, Default)]
pub struct Deeper {
    /// Acceleration (m/s²) and displacement (metres) of a passage per relative change of depth.
    pub trace: [Vec<f64>; 2],
    /// Square of that change beyond chance, in the residual of the base and of the corrected model.
    pub square: [f64; 2],
}

/// Puts into the predictions of all passages of a site what their trains differ by as a whole.
pub fn tell_apart(predicted: &mut [Prediction], observed: &[Observed], shapes: &[Shapes]) {
    let windows: Vec<Vec<f64>> = shapes.iter().map(|s| deeper(&s.moves)).collect();
    let speeds: Vec<f64> = observed.iter().map(|o| o.speed_m_s).collect();
    let temperatures: Vec<f64> = observed.iter().map(|o| o.temperature_c).collect();
    let squares = [1, 2].map(|model: usize| {
        let depths: Vec<Vec<f64>> =
            predicted.iter().zip(&windows).map(|(p, w)| depths(p, model, w)).collect();
        squares_beyond_chance(&depths, &[&speeds, &temperatures])
    });
    if squares.iter().flatten().all(|square| *square == 0.0) {
        return;
    }
    predicted.par_iter_mut().zip(&windows).enumerate().for_each(|(i, (p, window))| {
        let mut acceleration = vec![0.0; p.acceleration[0].len()];
        for start in &p.windows.0 {
            for (a, w) in acceleration.iter_mut().skip(*start).zip(window) {
                *a += w;
            }
        }
        let displacement = displacement(&acceleration);
        p.deeper = Deeper { trace: [acceleration, displacement], square: squares.each_ref().map(|s| s[i]) };
    });
}

/// How much deeper trains as a whole run over the crossing, standard deviation in the residual of the corrected model, relative; 0 within
/// chance.
pub fn depth_sd(predicted: &[Prediction]) -> f64 {
    mean(&predicted.iter().map(|p| p.deeper.square[1]).collect::<Vec<_>>()).max(0.0).sqrt()
}

/// Window per relative change of depth of both wheels.
fn deeper([front, rear]: &[super::linear::WheelMoves; 2]) -> Vec<f64> {
    front.depth.iter().zip(&rear.depth).map(|(f, r)| f + r).collect()
}

/// How much deeper each bogie runs than `model` (1 base, 2 corrected) says, relative.
fn depths(p: &Prediction, model: usize, window: &[f64]) -> Vec<f64> {
    let power = dot(window, window).max(f64::MIN_POSITIVE);
    let of = |start: &usize| {
        let residual = |k: usize| p.acceleration[0][k] - p.acceleration[model][k];
        let end = (start + window.len()).min(p.acceleration[0].len());
        (*start..end).map(|k| residual(k) * window[k - start]).sum::<f64>() / power
    };
    p.windows.0.iter().map(of).collect()
}

/// Squares by which trains depart from one another in what their bogies show, freed of what goes with `others`, less what bogies
/// make of a mean by chance; of each 0 where all together are within chance.
fn squares_beyond_chance(of_trains: &[Vec<f64>], others: &[&[f64]]) -> Vec<f64> {
    let means: Vec<f64> = of_trains.iter().map(|v| mean(v)).collect();
    let by_chance = |(v, m): (&Vec<f64>, &f64)| {
        let n = v.len() as f64;
        v.iter().map(|x| (x - m).powi(2)).sum::<f64>() / (n * (n - 1.0).max(1.0))
    };
    let chance = mean(&of_trains.iter().zip(&means).map(by_chance).collect::<Vec<_>>());
    let (all, lost) = (means.len() as f64, 1.0 + others.len() as f64);
    let squares: Vec<f64> =
        freed(&means, others).iter().map(|m| m * m * all / (all - lost).max(1.0)).collect();
    let differ = all > lost + 2.0 && mean(&squares) > BEYOND_CHANCE * chance;
    squares.iter().map(|square| if differ { square - chance } else { 0.0 }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::passage::random::Random;

    fn normal(random: &mut Random) -> f64 {
        (0..12).map(|_| random.unit()).sum::<f64>() - 6.0
    }

    /// Forty trains of six bogies, bogies 0.05 apart: trains that differ by 0.04, by nothing, and with the temperature only.
    #[test]
    fn property_what_trains_differ_by_is_found_and_nothing_else() {
        let mut random = Random::new(1, 0);
        let temperatures: Vec<f64> = (0..40).map(|i| f64::from(i * 7 % 40)).collect();
        let mut sites = |own: f64, per_kelvin: f64| -> f64 {
            let mut train = |t: &f64| -> Vec<f64> {
                let all = own * normal(&mut random) + per_kelvin * t;
                (0..6).map(|_| all + 0.05 * normal(&mut random)).collect()
            };
            let found = (0..20).map(|_| {
                let trains: Vec<Vec<f64>> = temperatures.iter().map(&mut train).collect();
                mean(&squares_beyond_chance(&trains, &[&temperatures]))
            });
            found.sum::<f64>() / 20.0
        };
        let found = sites(0.04, 0.0);
        assert!((found / 0.04_f64.powi(2) - 1.0).abs() < 0.15, "{found}");
        assert_eq!((sites(0.0, 0.0), sites(0.0, 0.005)), (0.0, 0.0));
    }
}
