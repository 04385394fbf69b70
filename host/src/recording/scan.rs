//! `irregularity.csv`: laser scan of the crossing.

use std::path::Path;

use super::files::{read_bytes, write_atomic};
use super::{RecordingError, Scan};

/// A scan is a few metres long around the nose tip.
pub const POSITION_M: f64 = 50.0;
/// Deepest irregularity of a crossing, metres; 1.4 mm written in mm exceeds it.
const IRREGULARITY_M: f64 = 0.05;
/// Largest step between two points, metres: 250 Hz at 50 m/s is a wavelength of 200 mm.
const SPACING_M: f64 = 0.1;
/// Smallest step, metres: no scanner resolves less, so it is a unit or a copy.
const LEAST_SPACING_M: f64 = 1e-4;
/// Positions are written to the micrometre.
const ROUNDING_M: f64 = 1e-6;
const MAX_POINTS: usize = 1_000_000;

/// Reads and checks the scan.
pub(super) fn read_scan(file: &Path) -> Result<Scan, RecordingError> {
    parse_scan(file, &read_bytes(file)?)
}

fn parse_scan(file: &Path, bytes: &[u8]) -> Result<Scan, RecordingError> {
    let damaged = |e: csv::Error| RecordingError::Damaged { file: file.into(), reason: e.to_string() };
    let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(bytes);
    let headers = reader.byte_headers().map_err(damaged)?.clone();
    let column = |name: &'static str| {
        headers.iter().position(|h| h == name.as_bytes()).ok_or_else(|| RecordingError::MissingColumn {
            file: file.into(),
            column: name,
            present: headers.iter().map(String::from_utf8_lossy).collect::<Vec<_>>().join(", "),
        })
    };
    let columns = [("position_m", column("position_m")?), ("irregularity_m", column("irregularity_m")?)];
    let mut scan = Scan { position_m: Vec::new(), irregularity_m: Vec::new() };
    for (row, record) in reader.byte_records().enumerate() {
        let record = record.map_err(damaged)?;
        let cell = |(column, k): (&'static str, usize)| {
            let text = String::from_utf8_lossy(record.get(k).unwrap_or_default());
            number(&text).map_err(|fault| RecordingError::Cell { file: file.into(), column, row, fault })
        };
        let (x, z) = (cell(columns[0])?, cell(columns[1])?);
        check_point(&scan, x, z).map_err(|(column, fault)| RecordingError::Cell {
            file: file.into(),
            column,
            row,
            fault,
        })?;
        scan.position_m.push(x);
        scan.irregularity_m.push(z);
    }
    match scan.position_m.as_slice() {
        [first, .., last] => check_cover([*first, *last]).map_err(|fault| RecordingError::Cell {
            file: file.into(),
            column: "position_m",
            row: scan.position_m.len() - 1,
            fault,
        })?,
        _ => return Err(RecordingError::NoRows { file: file.into() }),
    }
    Ok(scan)
}

/// Wheels pass from the wing rail to the nose near x = 0: a scan beside it has another origin.
fn check_cover([first, last]: [f64; 2]) -> Result<(), String> {
    match first <= 0.0 && last >= 0.0 {
        true => Ok(()),
        false => Err(format!(
            "the scan reaches from {first} to {last} m and does not cover x = 0, the tip of the nose; has it another origin?"
        )),
    }
}

fn number(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() => Ok(value),
        _ => Err(format!("`{text}` is not a finite number")),
    }
}

fn check_point(scan: &Scan, x: f64, z: f64) -> Result<(), (&'static str, String)> {
    if scan.position_m.len() >= MAX_POINTS {
        return Err(("position_m", format!("more than {MAX_POINTS} points; thin the scan out to 10 mm")));
    }
    if x.abs() > POSITION_M {
        return Err(("position_m", format!("{x} is more than {POSITION_M} m from the nose; is it in mm?")));
    }
    if z.abs() > IRREGULARITY_M {
        return Err(("irregularity_m", format!("{z} is deeper than {IRREGULARITY_M} m; is it in mm?")));
    }
    match scan.position_m.last() {
        Some(&last) if x <= last => Err(("position_m", format!("{x} does not follow {last}; sort the rows"))),
        Some(&last) if x - last < LEAST_SPACING_M - ROUNDING_M => Err((
            "position_m",
            format!(
                "{x} is {:.3} mm after {last}, less than {} mm; thin the scan out to 10 mm, or is it in km?",
                1e3 * (x - last),
                1e3 * LEAST_SPACING_M
            ),
        )),
        Some(&last) if x - last > SPACING_M => Err((
            "position_m",
            format!("a gap of {:.3} m after {last}; at most {SPACING_M} m is allowed", x - last),
        )),
        _ => Ok(()),
    }
}

/// Writes the scan, positions to the micrometre, depths to the nanometre.
pub(super) fn write_scan(file: &Path, scan: &Scan) -> Result<(), RecordingError> {
    let mut text = String::from("position_m,irregularity_m\n");
    for (x, z) in scan.position_m.iter().zip(&scan.irregularity_m) {
        text.push_str(&format!("{x:.6},{z:.9}\n"));
    }
    write_atomic(file, text.as_bytes())
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn property_arbitrary_bytes_never_panic(bytes in proptest::collection::vec(any::<u8>(), 0..600)) {
            let _ = parse_scan(Path::new("irregularity.csv"), &bytes);
        }

        #[test]
        fn property_arbitrary_rows_never_panic(rows in "([-0-9.eN,]{0,12}\n){0,20}") {
            let text = format!("position_m,irregularity_m\n{rows}");
            let _ = parse_scan(Path::new("irregularity.csv"), text.as_bytes());
        }
    }

    fn refused(rows: &str) -> String {
        let text = format!("position_m,irregularity_m\n{rows}");
        parse_scan(Path::new("x"), text.as_bytes()).unwrap_err().to_string()
    }

    /// It was taken for a level crossing where the trains met the nose.
    #[test]
    fn regress_a_scan_beside_the_nose_is_refused() {
        for (from, to, ends) in [(100, 190, "from 1 to 1.9 m"), (-200, -1, "from -2 to -0.01 m")] {
            let rows: String = (from..=to).map(|k| format!("{:.3},0.0001\n", f64::from(k) * 0.01)).collect();
            let error = refused(&rows);
            assert!(error.contains(ends) && error.contains("origin"), "{error}");
        }
    }

    /// Steps of nanometres let a scan of a micrometre pass for one of the crossing.
    #[test]
    fn regress_steps_that_no_scanner_has_are_refused() {
        let error = refused("-0.000001,0\n0.000001,0.0001\n");
        assert!(error.contains("row 1") && error.contains("0.002 mm"), "{error}");
        let least = parse_scan(Path::new("x"), b"position_m,irregularity_m\n-0.0001,0\n0.0,0\n0.0001,0\n");
        assert_eq!(least.unwrap().position_m.len(), 3);
    }

    #[test]
    fn regress_columns_in_any_order() {
        let scan = parse_scan(Path::new("x"), b"irregularity_m,position_m\n0.001,-0.01\n0.002,0\n").unwrap();
        assert_eq!(scan, Scan { position_m: vec![-0.01, 0.0], irregularity_m: vec![0.001, 0.002] });
    }
}
