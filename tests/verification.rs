//! The forward model and the methods of force identification against closed forms, other programs and the paper.

use std::sync::OnceLock;

use cpcm::progress::Silent;
use cpcm::recording::read_site;
use cpcm::recording::truth::read_truth;
use cpcm::scoring::Score;
use cpcm::verification::{Case, Verification, run, site_methods};
use cpcm_tests::sample::field;
use cpcm_tests::tolerance;

/// Half a minute of computing, shared by the tests.
fn verification() -> &'static Verification {
    static DONE: OnceLock<Verification> = OnceLock::new();
    DONE.get_or_init(|| run(&Silent).unwrap())
}

fn cases(words: &str) -> Vec<&'static Case> {
    let found: Vec<&Case> = verification().cases.iter().filter(|c| c.name.contains(words)).collect();
    assert!(!found.is_empty(), "no check is named {words}");
    found
}

fn all_pass(words: &str) {
    for case in cases(words) {
        assert!(
            case.passed(),
            "{}: expected {}, found {}, allowed {}",
            case.name,
            case.expected,
            case.found,
            case.tolerance
        );
    }
}

#[test]
fn analytic_closed_forms_are_met() {
    for words in ["Winkler", "two-layer", "pinned", "simply supported", "impulse response"] {
        all_pass(words);
    }
}

#[test]
fn property_identities_hold() {
    for words in ["reciprocity", "power into the track", "static force carried"] {
        all_pass(words);
    }
}

#[test]
fn reference_receptances_of_other_programs_are_met() {
    all_pass("T1 receptance");
    all_pass("panel receptance");
    assert_eq!(cases("panel receptance").len(), 12);
}

#[test]
fn reference_moving_force_is_met() {
    all_pass("T1 moving force");
}

#[test]
fn property_mesh_sampling_length_and_interpolation_have_converged() {
    for words in ["mesh 0.3 m", "sampling at 1 kHz", "37 sleepers", "interpolated from 0.3 m"] {
        all_pass(words);
    }
}

#[test]
fn reference_forces_of_200_passages_are_identified() {
    all_pass("force by evidence");
}

/// What the paper's own rule reaches on the same data stays beside it, and stays the paper's rule.
#[test]
fn paper_rule_is_reproduced_and_beaten() {
    all_pass("force by the paper's rule");
    for pads in ["soft pads, noise 1 %", "stiff pads, noise 1 %"] {
        let paper = cases(&format!("paper's rule, waveform, {pads}"))[0].found;
        let ours = cases(&format!("evidence, waveform, {pads}"))[0].found;
        assert!(paper > tolerance::PAPER_TO_EVIDENCE * ours, "{pads}: {paper} {ours}");
    }
}

#[test]
fn property_every_check_names_its_source_and_the_whole_passes() {
    let result = verification();
    assert!(result.cases.iter().all(|c| !c.source.is_empty() && c.tolerance > 0.0));
    assert!(result.tables.iter().all(|t| t.rows.iter().all(|r| r.len() == t.columns.len())));
    assert_eq!(result.failures(), 0);
}

/// On recordings with known force: the paper's chain, the chain in between, this program, in this order.
#[test]
fn paper_chain_stands_beside_the_analysis_on_recordings() {
    let dir = field("reference-3");
    let mut site = read_site(&dir).unwrap();
    site.passages.truncate(4);
    let found = site_methods(&site, &read_truth(&dir).unwrap(), &Silent).unwrap();
    let peak: Vec<f64> = found.methods.iter().map(|(_, s)| Score::median(&s.peak)).collect();
    let [ours, paper, between] = peak[..] else { panic!("three methods, got {}", peak.len()) };
    assert!(paper > tolerance::PAPER_TO_BETWEEN * between, "{paper} {between}");
    assert!(between > ours, "{between} {ours}");
    let displacement = |k: usize| Score::median(&found.methods[k].1.displacement);
    assert!(displacement(1) > tolerance::HIGH_PASS_LOSS, "a high-pass takes away the train's mean");
    assert!(displacement(2) < tolerance::MODEL_BELOW_3_HZ, "the model puts it back");
    assert_eq!(found.table(None).rows.len(), 5, "three methods, eq. 1 and the truth");
    let limits = &found.limits;
    assert!(
        limits.mean_error().abs() < tolerance::SHARED_SDS * limits.shared(),
        "{:.4}",
        limits.mean_error()
    );
    assert!(
        peak[0] < tolerance::PEAK_TO_EXPECTED * limits.median(),
        "{:.4} of {:.4} to be expected",
        peak[0],
        limits.median()
    );
}
