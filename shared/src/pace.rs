//! Giving the processor back during long calculations.
//!
//! The node runs one cooperative executor, and the sensor's FIFO must be emptied every 8 ms. Every loop of the
//! evaluation that can be long reports its work here.

use core::future::poll_fn;
use core::task::Poll;

/// Multiplications between two yields. They cost 3 to 6 instructions each with what belongs to them, so this is about
/// 1 ms at 30 million instructions a second.
const BUDGET: u32 = 6_000;

/// Counts work and yields when enough has been done.
#[derive(Debug, Default)]
pub struct Pace {
    spent: u32,
}

impl Pace {
    /// Reports `multiplications` done since the last call; yields to the executor when they add up.
    pub async fn spend(&mut self, multiplications: usize) {
        self.spent = self.spent.saturating_add(multiplications as u32);
        if self.spent >= BUDGET {
            self.spent = 0;
            yield_now().await;
        }
    }
}

/// Lets every other ready task run once.
pub async fn yield_now() {
    let mut yielded = false;
    poll_fn(|cx| {
        if yielded {
            return Poll::Ready(());
        }
        yielded = true;
        cx.waker().wake_by_ref();
        Poll::Pending
    })
    .await;
}

#[cfg(test)]
mod tests {
    use super::*;
    use core::pin::pin;
    use core::task::{Context, Waker};

    #[test]
    fn analytic_yields_once_per_budget() {
        let mut work = pin!(async {
            let mut pace = Pace::default();
            for _ in 0..40 {
                pace.spend(BUDGET as usize / 10).await;
            }
        });
        let mut cx = Context::from_waker(Waker::noop());
        let yields = (0..).take_while(|_| work.as_mut().poll(&mut cx).is_pending()).count();
        assert_eq!(yields, 4);
    }
}
