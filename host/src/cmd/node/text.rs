//! Numbers as the field engineer reads them.

use cpcm_shared::clock;
use cpcm_shared::sample::RAW_RATE_HZ;

/// µs since 1970-01-01 as ISO 8601 in UTC, to the second.
pub fn iso_utc(unix_us: u64) -> String {
    let seconds = unix_us / 1_000_000;
    let (days, in_day) = ((seconds / 86_400) as i64, seconds % 86_400);
    let (year, month, day) = civil(days);
    let (hour, minute, second) = (in_day / 3600, in_day / 60 % 60, in_day % 60);
    format!("{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{second:02}Z")
}

/// Date of a day counted from 1970-01-01 (Howard Hinnant, chrono-compatible low-level date algorithms).
fn civil(days: i64) -> (i64, i64, i64) {
    let z = days + 719_468;
    let era = z.div_euclid(146_097);
    let day_of_era = z.rem_euclid(146_097);
    let year_of_era = (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let shifted_month = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * shifted_month + 2) / 5 + 1;
    let month = if shifted_month < 10 { shifted_month + 3 } else { shifted_month - 9 };
    (year_of_era + era * 400 + i64::from(month <= 2), month, day)
}

/// When a raw sample was taken: wall time when the clock has been set since the start-up from which it is counted (`this_start`: the last
/// one), else time since start-up.
pub fn sample_time(sample: u64, this_start: bool, clock: &clock::State) -> String {
    let since = || duration(sample / u64::from(RAW_RATE_HZ));
    if !this_start {
        return format!("earlier start + {}", since());
    }
    let Some(binding) = clock.binding else { return format!("start + {}", since()) };
    let period_us = 1_000_000 / i128::from(RAW_RATE_HZ);
    let unix_us = i128::from(binding.unix_us) + (i128::from(sample) - i128::from(binding.sample)) * period_us;
    iso_utc(u64::try_from(unix_us).unwrap_or(0))
}

/// Seconds as days, hours, minutes and seconds.
pub fn duration(seconds: u64) -> String {
    let (days, hours, minutes) = (seconds / 86_400, seconds / 3600 % 24, seconds / 60 % 60);
    let clock = format!("{hours:02}:{minutes:02}:{:02}", seconds % 60);
    if days == 0 { clock } else { format!("{days} d {clock}") }
}

/// Parts per 10⁹ as parts per million.
pub fn drift(ppb: Option<i32>) -> String {
    ppb.map_or("not known yet (set the clock again in ten minutes or more)".into(), |ppb| {
        format!("{:+.2} ppm", f64::from(ppb) / 1000.0)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Dates from the `date` command.
    #[test]
    fn reference_dates() {
        for (seconds, text) in [
            (0, "1970-01-01T00:00:00Z"),
            (951_782_399, "2000-02-28T23:59:59Z"),
            (951_782_400, "2000-02-29T00:00:00Z"),
            (1_760_000_000, "2025-10-09T08:53:20Z"),
            (4_107_542_400, "2100-03-01T00:00:00Z"),
        ] {
            assert_eq!(iso_utc(seconds * 1_000_000), text);
        }
    }

    #[test]
    fn analytic_sample_time() {
        let mut clock = clock::State::default();
        assert_eq!(sample_time(4 * 86_400_000 + 4000 * 61, true, &clock), "start + 1 d 00:01:01");
        clock.binding = Some(clock::Binding { sample: 8000, unix_us: 1_760_000_000_000_000 });
        assert_eq!(sample_time(0, true, &clock), "2025-10-09T08:53:18Z");
        assert_eq!(sample_time(4000 * 61, false, &clock), "earlier start + 00:01:01");
    }
}
