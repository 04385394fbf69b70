//! What `verify` checks: numbers and curves of the model against closed forms, other programs and the paper.

/// All checks in the order of the method.
#[derive(Clone, Debug, Default)]
pub struct Verification {
    /// One per line of the table.
    pub cases: Vec<Case>,
}

/// One check.
#[derive(Clone, Debug)]
pub struct Case {
    /// What is compared, e.g. `static deflection of a beam on elastic foundation`.
    pub name: String,
    /// Where the expected value comes from: closed form with its source, program with its version, paper with its
    /// equation.
    pub source: String,
    /// Unit of both values.
    pub unit: &'static str,
    /// Expected value.
    pub expected: f64,
    /// Value of this program.
    pub found: f64,
    /// Largest relative difference allowed.
    pub tolerance: f64,
    /// The curves behind the two values, where there are any.
    pub curves: Option<Curves>,
}

/// Expected and found curve on the same abscissa.
#[derive(Clone, Debug)]
pub struct Curves {
    /// Caption with unit.
    pub x_caption: &'static str,
    /// Caption with unit.
    pub y_caption: &'static str,
    /// Abscissa, ascending.
    pub x: Vec<f64>,
    /// Expected.
    pub expected: Vec<f64>,
    /// Found.
    pub found: Vec<f64>,
}

impl Case {
    /// Difference relative to the expected value; absolute where zero is expected.
    pub fn error(&self) -> f64 {
        let difference = self.found - self.expected;
        if self.expected == 0.0 { difference.abs() } else { (difference / self.expected).abs() }
    }

    /// Whether the difference is allowed; NaN never is.
    pub fn passed(&self) -> bool {
        self.error() <= self.tolerance
    }
}

impl Verification {
    /// Number of checks that failed.
    pub fn failures(&self) -> usize {
        self.cases.iter().filter(|c| !c.passed()).count()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn analytic_relative_error_and_verdict() {
        let case = |expected, found| Case {
            name: String::new(),
            source: String::new(),
            unit: "m",
            expected,
            found,
            tolerance: 0.01,
            curves: None,
        };
        assert!(case(-2.0, -2.01).passed());
        assert!(!case(2.0, 2.1).passed());
        assert!(!case(2.0, f64::NAN).passed());
        assert!(case(0.0, 0.005).passed());
    }
}
