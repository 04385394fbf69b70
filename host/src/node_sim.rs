//! The node's code fed with the recordings of a site.

use cpcm_shared::detect::Detector;
use cpcm_shared::evaluate::{Kernel, Scratch, evaluate};
use cpcm_shared::operator::InMemory;
use cpcm_shared::package::{Header, PREFIX_LEN, header_len};
use cpcm_shared::passage::Buffer;
use cpcm_shared::record::Record;
use cpcm_shared::sample::SensorCode;
use cpcm_shared::sampler::{Event, Sampler};
use embassy_futures::block_on;

use crate::progress::Progress;
use crate::recording::Site;

/// Records of the passages.
pub fn records(site: &Site, package: &[u8], progress: &dyn Progress) -> anyhow::Result<Vec<Record>> {
    progress.begin("node", site.passages.len() as u64);
    let (header, id) = Header::decode(package).map_err(|e| anyhow::anyhow!("{e:?}"))?;
    let n = header_len(package[..PREFIX_LEN].try_into()?).map_err(|e| anyhow::anyhow!("{e:?}"))?;
    let mut payload = InMemory(&package[PREFIX_LEN + n as usize..]);
    let mut sampler = Sampler::new(Detector::default(), 1);
    let mut buffer = Box::new(Buffer::new());
    let mut scratch = Box::new(Scratch::new());
    let mut out = Vec::new();
    for p in &site.passages {
        let head = &p.acceleration_m_s2[..1000];
        let quiet = head.iter().chain(head.iter().rev()).cycle().take(10000);
        let codes: Vec<SensorCode> = quiet
            .clone()
            .chain(&p.acceleration_m_s2)
            .chain(quiet)
            .map(|a| SensorCode::from_m_s2(f64::from(*a)))
            .collect();
        for burst in codes.chunks(32) {
            if let Some(Event::Recorded(passage)) = sampler.push_burst(burst, Some(&mut buffer)) {
                out.push(block_on(evaluate(
                    &passage,
                    buffer.samples(),
                    Some(Kernel { header: &header, id, payload: &mut payload }),
                    &mut scratch,
                )));
                buffer.clear();
            }
        }
        progress.step();
    }
    Ok(out)
}
