//! Link task: answers the field tool.

use cpcm_shared::frame::Decoder;
use cpcm_shared::message::Live;
use cpcm_shared::server::Server;
use embassy_futures::yield_now;
use embedded_io_async::{Read, Write};
use embedded_storage_async::nor_flash::MultiwriteNorFlash;

use super::Node;

/// Answers requests for ever. An error of the port (noise, overrun) costs the frame, and the tool asks again.
pub async fn link<F: MultiwriteNorFlash>(
    node: &Node<F>,
    mut rx: impl Read,
    mut tx: impl Write,
    decoder: &mut Decoder,
    server: &mut Server,
) -> ! {
    let mut bytes = [0; 64];
    loop {
        let Ok(count) = rx.read(&mut bytes).await else {
            yield_now().await; // a port that only fails must not hold the processor
            continue;
        };
        for &byte in bytes.iter().take(count) {
            let link_errors = decoder.counters().errors();
            let Some(request) = decoder.push(byte) else { continue };
            let mut live: Live = node.live();
            live.counters.link_errors = link_errors;
            let mut storage = node.storage.lock().await;
            let reply = server.answer(request, &mut storage, &live).await;
            drop(storage);
            if tx.write_all(reply).await.is_err() {
                defmt::warn!("reply not sent");
            }
        }
    }
}
