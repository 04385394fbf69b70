//! The report as a file: complete, self-contained, the same every time.

use std::path::Path;

use cpcm::report::{self, verification};
use cpcm::verification::{Case, Curves, Table, Verification};
use cpcm_tests::sample::sample_analysis;

/// Leaves a page in the target directory, for a look with a browser. Cargo makes that directory only when it compiles.
fn leave(name: &str, page: &str) {
    let directory = Path::new(env!("CARGO_TARGET_TMPDIR"));
    std::fs::create_dir_all(directory).unwrap();
    std::fs::write(directory.join(name), page).unwrap();
}

#[test]
fn regress_page_is_self_contained_and_reproducible() {
    let analysis = sample_analysis();
    let page = report::html(&analysis).unwrap();
    assert_eq!(page, report::html(&analysis).unwrap());
    leave("report.html", &page);
    for forbidden in ["<script", "src=", "href=", "@import", "url("] {
        assert!(!page.contains(forbidden), "{forbidden}");
    }
    // The only address in the page is the name of the SVG namespace.
    let addresses = page.matches("http").count();
    assert_eq!(addresses, page.matches("http://www.w3.org/2000/svg").count());
    assert_eq!(page.matches("<svg").count(), 9);
    // A phone on a slow link still loads it.
    assert!(page.len() < 4_000_000, "{} bytes", page.len());
}

/// Curves of left-out passages were drawn with the others, and moved their mean.
#[test]
fn regress_figures_leave_out_passages_that_mean_nothing() {
    let clean = sample_analysis();
    let mut spoilt = clean.clone();
    let mut passage = clean.passages[0].clone();
    for wheelset in &mut passage.wheelsets {
        wheelset.flags.push("unlike-model".into());
        wheelset.contact_force_n.iter_mut().for_each(|f| *f *= 10.0);
    }
    spoilt.passages.push(passage);
    let figure = |page: &str| -> String {
        let (_, after) = page.split_once("contact force over position for all wheelsets").unwrap();
        after.split_once("</svg>").unwrap().0.into()
    };
    let [page, sound] = [&spoilt, &clean].map(|analysis| report::html(analysis).unwrap());
    assert_eq!(figure(&page), figure(&sound));
    let left_out = format!("mean nothing: 1 of {} passages", spoilt.passages.len());
    assert!(page.contains(&left_out));
    assert!(!sound.contains("mean nothing"));
}

#[test]
fn regress_page_of_an_empty_analysis_is_drawn() {
    let mut analysis = sample_analysis();
    analysis.passages.clear();
    analysis.scan = None;
    let page = report::html(&analysis).unwrap();
    assert!(!page.contains("NaN"));
    assert!(page.contains("0 used, 0 left out") && page.contains("no passages, recorded at 4000 Hz"));
    assert_eq!(page.matches("<svg").count(), 9);
}

#[test]
fn regress_page_with_missing_numbers_is_drawn() {
    let mut analysis = sample_analysis();
    analysis.passages[0].wheelsets[0].contact_force_n.fill(f64::NAN);
    analysis.passages[1].speed_m_s = f64::NAN;
    analysis.passages[2].axle_times_s.clear();
    analysis.indicators.peak_force_n.threshold = 0.0;
    let page = report::html(&analysis).unwrap();
    assert!(!page.contains("NaN"));
    assert!(page.contains("24 used, 0 left out"));
    assert_eq!(page.matches("<svg").count(), 9);
}

#[test]
fn regress_verification_page_shows_failures() {
    let case = |name: &str, found| Case {
        name: name.into(),
        source: "closed form, test".into(),
        unit: "m",
        expected: 1.0,
        found,
        tolerance: 0.01,
        at_most: false,
        curves: Some(Curves {
            x_caption: "frequency, Hz",
            y_caption: "receptance, m/N",
            x: (0..100).map(f64::from).collect(),
            expected: (0..100).map(|i| 1.0 / (1.0 + f64::from(i))).collect(),
            found: (0..100).map(|i| found / (1.0 + f64::from(i))).collect(),
        }),
    };
    let table = Table {
        title: "A study".into(),
        note: "What it shows & why.".into(),
        columns: vec!["mesh, m".into(), "error".into()],
        rows: vec![vec!["0.3".into(), "0.25 %".into()]],
    };
    let result = Verification { cases: vec![case("first", 1.001), case("second", 1.5)], tables: vec![table] };
    let page = verification::html(&result).unwrap();
    assert!(page.contains("1 of 2 checks failed"));
    assert_eq!(page.matches("<svg").count(), 2);
    assert!(page.contains("shows &amp; why") && verification::table(&result).contains("0.3      0.25 %"));
    assert_eq!(verification::table(&result).matches("FAILED").count(), 1);
    assert!(verification::csv(&result).lines().nth(2).unwrap().ends_with(",0.5,0.01,false"));
    leave("verification.html", &page);
}
