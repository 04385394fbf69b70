//! `cpcm kernel`

use std::path::PathBuf;

use anyhow::Context;
use clap::Args;
use serde_json::json;

use super::analyse::{warn_of_damping, warn_of_other_way};
use super::output::{print, print_json, warn, warn_skipped};
use super::progress::Bar;
use super::with_effects::Effects;
use crate::gap::corrected::Purpose;
use crate::identify::{IdentifiedSite, identify};
use crate::kernel::SENSOR_RANGE_M_S2;
use crate::pipeline;
use crate::recording::files::{check_file, write_atomic};
use crate::recording::read_site;

/// Calibrate a crossing and write the kernel package for its node
#[derive(Args)]
#[command(after_help = "Example:\n  cpcm kernel tests/data/field/reference-1 --out kernel.bin")]
pub(super) struct KernelArgs {
    /// Site directory
    site: PathBuf,
    /// File for the package
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    #[command(flatten)]
    effects: Effects,
    /// Print a summary as JSON
    #[arg(long)]
    json: bool,
}

impl KernelArgs {
    pub(super) fn run(self) -> anyhow::Result<()> {
        let site =
            read_site(&self.site).with_context(|| format!("cannot read site {}", self.site.display()))?;
        warn_skipped(&site.skipped);
        check_file(&self.out)?;
        let read = site.skipped.len();
        let (site, included) = self.effects.included_in(site, Purpose::Kernel)?;
        warn_skipped(&site.skipped[read..]);
        let bar = Bar::new();
        let cannot = || format!("cannot make a kernel for site {}", self.site.display());
        let identified = identify(&site, &bar).with_context(cannot)?;
        let package = pipeline::package(&identified, &bar).with_context(cannot)?;
        drop(bar);
        warn_of_left_out(&identified);
        warn_of_damping(&pipeline::damping_estimate(&identified));
        write_atomic(&self.out, &package.bytes).context("cannot write the kernel package")?;
        if let [slowest, .., fastest] | [slowest @ fastest] = &package.outside_m_s[..] {
            warn(&format!(
                "{} of {} recorded trains, {slowest:.1} to {fastest:.1} m/s, are not in the package: the node has no room for more \
                 speeds, and will flag them speed-outside",
                package.outside_m_s.len(),
                site.passages.len()
            ));
        }
        if let [.., largest] = package.beyond_m_s2[..] {
            warn(&format!(
                "{} of {} recordings reach beyond the {SENSOR_RANGE_M_S2:.0} m/s2 that the node's sensor takes beside gravity, up to \
                 {largest:.0} m/s2: it will clip and flag these trains clipped; their forces may be wrong beyond their intervals",
                package.beyond_m_s2.len(),
                site.passages.len()
            ));
        }
        let (file, bytes) = (self.out.display().to_string(), package.bytes.len());
        let [slowest, fastest] = package.speeds_m_s;
        if self.json {
            return print_json(&json!({
                "site": site.crossing.name,
                "file": file,
                "bytes": bytes,
                "speeds_m_s": package.speeds_m_s,
                "outside_m_s": package.outside_m_s,
                "beyond_m_s2": package.beyond_m_s2,
                "effects_included": included,
            }));
        }
        let with =
            if included.is_empty() { String::new() } else { format!(", with {}", included.join(", ")) };
        print(&format!(
            "{file}: kernel package of {bytes} bytes for site {}, trains of {slowest:.1} to {fastest:.1} m/s{with}\n",
            site.crossing.name
        ))
    }
}

/// Says on standard error which recordings the kernel is not of.
fn warn_of_left_out(identified: &IdentifiedSite) {
    let passages = &identified.site.passages;
    let ids = |wanted: &dyn Fn(&usize) -> bool| -> Vec<String> {
        (0..passages.len()).filter(wanted).map(|i| passages[i].passage_id.to_string()).collect()
    };
    let other_way = |i: &usize| identified.other_way.contains(i);
    let described = identified.site.crossing.traffic_direction;
    warn_of_other_way(&ids(&other_way), described);
    if !identified.other_way.is_empty() {
        warn(&format!(
            "the node applies the kernel to every train: its results of those that run {} are wrong",
            described.reversed()
        ));
    }
    let unlike = ids(&|i| !other_way(i) && !identified.explains(*i));
    if !unlike.is_empty() {
        warn(&format!(
            "the model does not explain the recordings of passages {}, which the kernel is not of; see `cpcm analyse`",
            unlike.join(", ")
        ));
    }
}
