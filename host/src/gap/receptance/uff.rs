//! Universal files, dataset 58 as text (functions at nodal degrees of freedom), as analysers export them: frequency
//! responses with their coherence, or hits as time series.
//!
//! Fields are separated by blanks, which the prescribed widths guarantee. Lines of a dataset 58, counted from 1: 1 to 5 text, 6
//! kind of function, 7 form of the data, 8 to 11 axes (abscissa, numerator, denominator, z), then the values (Structural
//! Dynamics Research Laboratory, University of Cincinnati: Universal File Formats for Modal Analysis Testing).

use faer::c64;

use super::{Content, Hit, Receptance, ReceptanceError, check_coherence, even_rate_hz};

/// What an axis means (`specific data type`).
const DISPLACEMENT: i64 = 8;
const VELOCITY: i64 = 11;
const ACCELERATION: i64 = 12;
const FORCE: i64 = 13;
/// Kinds of function.
const TIME_RESPONSE: i64 = 1;
const FREQUENCY_RESPONSE: i64 = 4;
const COHERENCE: i64 = 6;
/// Most values of a function.
const MOST_VALUES: usize = 1 << 24;

/// One dataset 58.
struct Function {
    kind: i64,
    numerator: i64,
    denominator: i64,
    /// Abscissas: Hz or s.
    at: Vec<f64>,
    value: Vec<c64>,
    /// Line of every value in the dataset, from 1.
    line: Vec<usize>,
}

/// Reads a file; `file` names it in errors.
pub(super) fn read(file: &str, text: &str) -> Result<Content, ReceptanceError> {
    let wrong =
        |line: usize, what: &'static str| ReceptanceError::Universal { file: file.into(), line, what };
    let lines: Vec<&str> = text.lines().collect();
    let mut functions = Vec::new();
    let mut at = 0;
    while at < lines.len() {
        if lines[at].trim() != "-1" {
            at += 1;
            continue;
        }
        let Some(kind) = lines.get(at + 1).map(|l| l.trim()) else { break };
        let begin = at + 2;
        let length = lines[begin.min(lines.len())..].iter().position(|l| l.trim() == "-1");
        let Some(length) = length else { return Err(wrong(lines.len(), "a dataset without its end (-1)")) };
        let body = &lines[begin..begin + length];
        let at_line = |(line, what): (usize, &'static str)| wrong(begin + line, what);
        match kind {
            "58" => {
                let function = function(body).map_err(at_line)?;
                if function.kind == COHERENCE {
                    let lines = function.line.iter().map(|line| begin + line);
                    check_coherence(file, lines.zip(function.value.iter().map(|v| v.re)))?;
                }
                functions.push(function);
            }
            "164" => units(body).map_err(at_line)?,
            k if k.starts_with("58") => {
                return Err(wrong(at + 2, "a binary dataset 58; export it as text"));
            }
            _ => {}
        }
        at = begin + length + 1;
    }
    content(file, &functions, &|what| wrong(lines.len(), what))
}

/// The dataset of units must say SI.
fn units(body: &[&str]) -> Result<(), (usize, &'static str)> {
    let code = body.first().and_then(|l| l.split_whitespace().next());
    if code == Some("1") { Ok(()) } else { Err((1, "units other than SI (dataset 164, code 1)")) }
}

fn function(body: &[&str]) -> Result<Function, (usize, &'static str)> {
    let integers = |line: usize| -> Vec<i64> {
        let words = body.get(line - 1).map_or("", |l| l).split_whitespace();
        words.map_while(|w| w.parse().ok()).collect()
    };
    let kind = *integers(6).first().ok_or((6, "no kind of function"))?;
    let numerator = *integers(9).first().ok_or((9, "no numerator"))?;
    // A time series has none.
    let denominator = integers(10).first().copied().unwrap_or(0);
    let form: Vec<f64> =
        body.get(6).map_or("", |l| l).split_whitespace().map_while(|w| w.parse().ok()).collect();
    let [ordinate, count, even, first, step] =
        form.get(..5).and_then(|f| f.try_into().ok()).ok_or((7, "no form of the data"))?;
    let complex = match ordinate as i64 {
        2 | 4 => false,
        5 | 6 => true,
        _ => return Err((7, "an unknown type of data; 2, 4, 5, 6 are known")),
    };
    let count = if count >= 2.0 && count <= MOST_VALUES as f64 {
        count as usize
    } else {
        return Err((7, "no or too many values"));
    };
    let even = even != 0.0;
    if even && !(step > 0.0 && step.is_finite() && first.is_finite()) {
        return Err((7, "a spacing that is not positive"));
    }
    let numbers = values(body)?;
    let parts = usize::from(!even) + 1 + usize::from(complex);
    if numbers.len() != parts * count {
        return Err((7, "not as many values as stated"));
    }
    let ordinate = usize::from(!even);
    let of =
        |row: &[(usize, f64)]| c64::new(row[ordinate].1, if complex { row[ordinate + 1].1 } else { 0.0 });
    let rows = || numbers.chunks_exact(parts);
    Ok(Function {
        kind,
        numerator,
        denominator,
        at: rows()
            .enumerate()
            .map(|(k, row)| if even { first + k as f64 * step } else { row[0].1 })
            .collect(),
        value: rows().map(of).collect(),
        line: rows().map(|row| row[ordinate].0).collect(),
    })
}

/// All numbers after the head of a dataset, with their lines.
fn values(body: &[&str]) -> Result<Vec<(usize, f64)>, (usize, &'static str)> {
    let words =
        body.iter().enumerate().skip(11).flat_map(|(i, l)| l.split_whitespace().map(move |w| (i + 1, w)));
    words
        .map(|(line, word)| {
            let value: f64 =
                word.replace(['D', 'd'], "E").parse().map_err(|_| (line, "a value that is no number"))?;
            if value.is_finite() { Ok((line, value)) } else { Err((line, "a value that is not finite")) }
        })
        .collect()
}

/// Makes an error of what is wrong with a file as a whole.
type Wrong<'a> = &'a dyn Fn(&'static str) -> ReceptanceError;

fn content(file: &str, functions: &[Function], wrong: Wrong) -> Result<Content, ReceptanceError> {
    match only(file, functions, (FREQUENCY_RESPONSE, "frequency responses"))? {
        Some(response) => {
            let coherence = only(file, functions, (COHERENCE, "coherences"))?;
            estimate(response, coherence).map(Content::Estimate).map_err(wrong)
        }
        None => hits(file, functions, wrong).map(Content::Hits),
    }
}

/// The function of a kind; of several no one says which is the hammer's and the sensor's.
fn only<'a>(
    file: &str,
    functions: &'a [Function],
    (kind, what): (i64, &'static str),
) -> Result<Option<&'a Function>, ReceptanceError> {
    let mut found = functions.iter().filter(|f| f.kind == kind);
    let first = found.next();
    match found.count() {
        0 => Ok(first),
        more => Err(ReceptanceError::Several { file: file.into(), what, functions: more + 1 }),
    }
}

fn estimate(response: &Function, coherence: Option<&Function>) -> Result<Receptance, &'static str> {
    let coherence = coherence.ok_or("a frequency response without its coherence (function type 6)")?;
    if coherence.at != response.at {
        return Err("coherence and frequency response at different frequencies");
    }
    if response.denominator != FORCE {
        return Err("a frequency response that is not per force (type 13)");
    }
    let order = order(response.numerator)?;
    let lines =
        response.at.iter().zip(&response.value).zip(&coherence.value).map(|((f, value), coherence)| {
            let iw = c64::new(0.0, std::f64::consts::TAU * f);
            (*f, value / iw.powu(order), coherence.re)
        });
    Ok(Receptance::estimated(lines))
}

/// Derivatives by time between displacement and what was measured.
fn order(numerator: i64) -> Result<u32, &'static str> {
    match numerator {
        DISPLACEMENT => Ok(0),
        VELOCITY => Ok(1),
        ACCELERATION => Ok(2),
        _ => Err("a response that is neither displacement, velocity nor acceleration (types 8, 11, 12)"),
    }
}

/// Series of force and of acceleration, taken in pairs as they come.
fn hits(file: &str, functions: &[Function], wrong: Wrong) -> Result<Vec<Hit>, ReceptanceError> {
    let series = |what: i64| functions.iter().filter(move |f| f.kind == TIME_RESPONSE && f.numerator == what);
    let [forces, responses] = [FORCE, ACCELERATION].map(|what| series(what).count());
    if forces != responses {
        return Err(ReceptanceError::Unpaired { file: file.into(), forces, responses });
    }
    let hit = |(force, response): (&Function, &Function)| {
        if response.at != force.at {
            return Err(wrong("force and acceleration at different times"));
        }
        let real = |f: &Function| f.value.iter().map(|v| v.re).collect();
        let rate_hz = even_rate_hz(file, &force.at)?;
        Ok(Hit { rate_hz, force_n: real(force), acceleration_m_s2: real(response) })
    };
    let hits: Vec<Hit> = series(FORCE).zip(series(ACCELERATION)).map(hit).collect::<Result<_, _>>()?;
    match hits.is_empty() {
        true => {
            Err(wrong("neither a frequency response (type 4) nor series of force and acceleration (type 1)"))
        }
        false => Ok(hits),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A dataset 58 as the format prescribes it.
    fn dataset(kind: i64, numerator: i64, denominator: i64, complex: bool, values: &[c64]) -> String {
        let mut text = "    -1\n    58\nNONE\nNONE\n22-Nov-26 12:00:00\nNONE\nNONE\n".to_string();
        text += &format!(
            "{kind:5}{:10}{:5}{:10} {:10}{:10}{:4} {:10}{:10}{:4}\n",
            1, 1, 0, "NONE", 1, 3, "NONE", 2, 3
        );
        text += &format!(
            "{:10}{:10}{:10}{:13.5e}{:13.5e}{:13.5e}\n",
            if complex { 5 } else { 2 },
            values.len(),
            1,
            0.0,
            2.0,
            0.0
        );
        for axis in [18, numerator, denominator, 0] {
            text += &format!("{axis:10}{:5}{:5}{:5} {:20} {:20}\n", 0, 0, 0, "NONE", "NONE");
        }
        let numbers: Vec<f64> =
            values.iter().flat_map(|v| if complex { vec![v.re, v.im] } else { vec![v.re] }).collect();
        for row in numbers.chunks(6) {
            text += &row.iter().map(|v| format!("{v:13.5e}")).collect::<String>();
            text.push('\n');
        }
        text + "    -1\n"
    }

    fn frequency_response() -> String {
        // Accelerance of a spring, k = 1e6 N/m: −ω²/k.
        let accelerance: Vec<c64> = (0..50)
            .map(|k| c64::new(-(std::f64::consts::TAU * 2.0 * f64::from(k)).powi(2) / 1e6, 0.0))
            .collect();
        dataset(4, ACCELERATION, FORCE, true, &accelerance)
            + &dataset(6, 0, 0, false, &[c64::new(0.97, 0.0); 50])
    }

    #[test]
    fn analytic_accelerance_of_a_spring_is_its_compliance() {
        let Content::Estimate(found) = read("a.uff", &frequency_response()).unwrap() else { panic!("hits") };
        assert_eq!(found.frequency_hz.len(), 49, "nothing at 0 Hz");
        assert!(found.receptance_m_n.iter().all(|r| (r * 1e6 - 1.0).norm() < 1e-4));
        assert!(found.coherence.iter().all(|c| (c - 0.97).abs() < 1e-12));
    }

    #[test]
    fn property_series_are_taken_in_pairs() {
        let series =
            |size: f64| -> Vec<c64> { (0..64).map(|k| c64::new(size * f64::from(k), 0.0)).collect() };
        let text =
            dataset(1, FORCE, 0, false, &series(1.0)) + &dataset(1, ACCELERATION, 0, false, &series(2.0));
        let Content::Hits(found) = read("a.uff", &text).unwrap() else { panic!("an estimate") };
        assert_eq!((found.len(), found[0].rate_hz), (1, 0.5));
        assert_eq!((found[0].force_n[3], found[0].acceleration_m_s2[3]), (3.0, 6.0));
    }

    #[test]
    fn property_series_with_a_missing_sample_are_refused() {
        // Form of the data: real, 64 values, with their abscissas.
        let uneven = |numerator: i64| {
            let pairs: Vec<c64> =
                (0..64).map(|k| f64::from(k + i32::from(k > 30)) * 1e-4).map(|t| c64::new(t, 1.0)).collect();
            let even = dataset(1, numerator, 0, true, &pairs);
            even.replacen("         5        64         1", "         2        64         0", 1)
        };
        let found = read("a.uff", &(uneven(FORCE) + &uneven(ACCELERATION)));
        assert!(matches!(found, Err(ReceptanceError::Uneven { sample: 32, .. })), "{found:?}");
    }

    #[test]
    fn property_what_is_not_understood_is_refused_with_its_line() {
        let text = frequency_response();
        let ones = [c64::new(1.0, 0.0); 4];
        let coherence = dataset(6, 0, 0, false, &ones);
        let cases = [
            ("without its end", text.trim_end().trim_end_matches("-1").to_string()),
            ("coherence", dataset(4, ACCELERATION, FORCE, true, &ones)),
            ("binary", text.replacen("    58\n", "    58b     1     2\n", 1)),
            ("SI", format!("    -1\n   164\n         3 inches\n    -1\n{text}")),
            ("per force", dataset(4, ACCELERATION, 0, true, &ones) + &coherence),
            ("neither displacement", dataset(4, FORCE, FORCE, true, &ones) + &coherence),
            ("finite", text.replace("9.70000e-1", "       NaN")),
            ("neither a frequency response", dataset(2, FORCE, 0, false, &ones)),
        ];
        for (what, text) in cases {
            let error = read("a.uff", &text).unwrap_err();
            let named =
                matches!(error, ReceptanceError::Universal { .. }) && error.to_string().contains(what);
            assert!(named, "{what}: {error}");
        }
    }

    /// Of unequal numbers the series left over were dropped, and with them hits; which belong together is not known either.
    #[test]
    fn regress_series_without_their_other_are_refused() {
        let series = |what: i64| dataset(1, what, 0, false, &[c64::new(1.0, 0.0); 64]);
        let text = series(FORCE) + &series(ACCELERATION) + &series(FORCE);
        let error = read("a.uff", &text).unwrap_err();
        assert!(matches!(error, ReceptanceError::Unpaired { forces: 2, responses: 1, .. }), "{error}");
        let error = read("a.uff", &series(ACCELERATION)).unwrap_err();
        assert!(matches!(error, ReceptanceError::Unpaired { forces: 0, responses: 1, .. }), "{error}");
    }

    /// The first of several was taken, whatever point it was of.
    #[test]
    fn regress_several_frequency_responses_are_refused_with_their_number() {
        let one = frequency_response();
        let error = read("a.uff", &one.repeat(3)).unwrap_err();
        assert!(matches!(error, ReceptanceError::Several { functions: 3, .. }), "{error}");
        assert!(error.to_string().contains("3 frequency responses"), "{error}");
    }

    #[test]
    fn regress_coherence_in_percent_is_refused_with_its_line() {
        let text = frequency_response();
        let line = text.lines().position(|l| l.contains("9.70000e-1")).unwrap() + 2;
        // The first value of the second line.
        let (before, coherences) = text.split_at(text.find("   9.70000e-1").unwrap());
        let (first, rest) = coherences.split_at(coherences.find('\n').unwrap());
        let spoilt = format!("{before}{first}{}", rest.replacen("   9.70000e-1", "   9.70000e+1", 1));
        let error = read("a.uff", &spoilt).unwrap_err();
        let found = matches!(error, ReceptanceError::Coherence { line: l, coherence: 97.0, .. } if l == line);
        assert!(found, "{error}, not line {line}");
    }

    /// Cut anywhere, and with any byte changed, it is read or refused.
    #[test]
    fn property_damaged_files_do_not_panic() {
        let text = frequency_response();
        let mut random = crate::passage::random::Random::new(5, 0);
        for _ in 0..2000 {
            let mut bytes = text.clone().into_bytes();
            bytes.truncate((random.unit() * bytes.len() as f64) as usize + 1);
            for _ in 0..3 {
                let k = random.below(bytes.len());
                bytes[k] = (random.unit() * 256.0) as u8;
            }
            let _ = read("a.uff", &String::from_utf8_lossy(&bytes));
        }
    }
}
