//! Numbers of `crossing.toml` by their place in it, such as `rail.second_moment_m4`.

use std::path::Path;

use serde::Deserialize;
use toml::{Table, Value};

use super::{Crossing, RecordingError, check_crossing};

impl Crossing {
    /// The number of an entry, in its unit; none where there is no such entry, or it is a word or a count.
    pub fn number(&self, entry: &str) -> Option<f64> {
        place(&mut Table::try_from(self).ok()?, entry).copied()
    }

    /// The same with another number there; refused where no crossing panel can have it, unless no panel could have what is there without it:
    /// what a diagnosis has put there may be beyond that.
    pub fn with_number(&self, entry: &str, value: f64) -> Result<Self, RecordingError> {
        let file = Path::new("crossing.toml");
        let fault = |reason: String| RecordingError::Key { file: file.into(), key: entry.into(), reason };
        let mut table = Table::try_from(self).map_err(|e| fault(e.to_string()))?;
        *place(&mut table, entry).ok_or_else(|| fault("there is no such number".into()))? = value;
        let mut other = Self::deserialize(table).map_err(|e| fault(e.to_string()))?;
        other.track.load_transfer = self.track.load_transfer;
        other.ballast.support_factor.clone_from(&self.ballast.support_factor);
        if check_crossing(file, self).is_ok() {
            check_crossing(file, &other)?;
        }
        Ok(other)
    }
}

fn place<'t>(table: &'t mut Table, entry: &str) -> Option<&'t mut f64> {
    let (section, key) = entry.split_once('.')?;
    match table.get_mut(section)?.get_mut(key)? {
        Value::Float(number) => Some(number),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recording::read_site;

    fn crossing() -> Crossing {
        let dir = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data/field/reference-1");
        read_site(&dir).unwrap().crossing
    }

    /// What a diagnosis has put there, and the file does not hold, stays.
    #[test]
    fn property_one_number_is_another_and_all_else_the_same() {
        let mut crossing = crossing();
        crossing.track.load_transfer = 0.05;
        crossing.ballast.support_factor = vec![(1, 0.5)];
        assert_eq!(crossing.number("sensor.y_m"), Some(2.3));
        let mut expected = crossing.clone();
        expected.sensor.y_m = 2.25;
        assert_eq!(crossing.with_number("sensor.y_m", 2.25).unwrap(), expected);
    }

    #[test]
    fn property_only_numbers_that_a_panel_can_have() {
        let crossing = crossing();
        for entry in ["", "name", "sensor", "sensor.x_m", "track.n_sleepers", "rail.profile", "sensor.y_m.z"]
        {
            assert_eq!(crossing.number(entry), None, "{entry}");
            assert!(crossing.with_number(entry, 1.0).is_err(), "{entry}");
        }
        for value in [f64::NAN, f64::INFINITY, -1.0, 1e3] {
            let error = crossing.with_number("sleeper.length_m", value).unwrap_err().to_string();
            assert!(error.contains("sleeper.length_m"), "{error}");
        }
        let beyond = crossing.with_number("sensor.y_m", 3.6).unwrap_err().to_string();
        assert!(beyond.contains("beyond the sleeper end"), "{beyond}");
    }

    /// With much ballast that moves with the sleepers every tolerance was refused, and the finished analysis with it.
    #[test]
    fn regress_what_a_diagnosis_has_put_there_refuses_no_other_number() {
        let mut crossing = crossing();
        crossing.sleeper.density_kg_m3 = 15e3;
        assert!(check_crossing(Path::new("crossing.toml"), &crossing).is_err());
        assert_eq!(crossing.with_number("sensor.y_m", 2.25).unwrap().sensor.y_m, 2.25);
    }
}
