//! Raw sensor codes of the ADXL357 and their unit.
//!
//! Sign convention of the whole project: positive is downwards.

/// Standard gravity, m/s² (CGPM 1901).
pub const STANDARD_GRAVITY_M_S2: f64 = 9.80665;
/// Sensitivity in the ±40 g range, codes per g (ADXL357 data sheet, table 1: 12 800 LSB/g).
pub const CODES_PER_G: i32 = 12_800;
/// Code at the end of the specified range, 40 g. The 20-bit word itself reaches a little further.
pub const FULL_SCALE_CODE: i32 = 40 * CODES_PER_G;
/// Acceleration of one code, m/s².
pub const M_S2_PER_CODE: f32 = (STANDARD_GRAVITY_M_S2 / CODES_PER_G as f64) as f32;
/// Rate at which the sensor samples, Hz.
pub const RAW_RATE_HZ: u32 = 4000;

/// One raw sample: 20-bit two's complement, sign-extended.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct SensorCode(i32);

impl SensorCode {
    /// Smallest 20-bit code.
    pub const MIN: Self = Self(-(1 << 19));
    /// Largest 20-bit code.
    pub const MAX: Self = Self((1 << 19) - 1);

    /// A code from a sign-extended number; what does not fit in 20 bit saturates.
    pub const fn new(code: i32) -> Self {
        if code < Self::MIN.0 {
            Self::MIN
        } else if code > Self::MAX.0 {
            Self::MAX
        } else {
            Self(code)
        }
    }

    /// A code from the low 20 bits of a register word, as the sensor sends it.
    pub const fn from_bits(word: u32) -> Self {
        Self(((word << 12) as i32) >> 12)
    }

    /// The sign-extended number.
    pub const fn get(self) -> i32 {
        self.0
    }

    /// Nearest code to an acceleration in m/s², saturating at the end of the range like the sensor; 0 for NaN.
    pub fn from_m_s2(acceleration: f64) -> Self {
        let code = acceleration * (CODES_PER_G as f64 / STANDARD_GRAVITY_M_S2);
        let rounded = if code < 0.0 { code - 0.5 } else { code + 0.5 };
        // `as` truncates towards zero, saturates, and maps NaN to 0.
        Self((rounded as i32).clamp(-FULL_SCALE_CODE, FULL_SCALE_CODE))
    }

    /// Acceleration, m/s².
    pub fn to_m_s2(self) -> f32 {
        self.0 as f32 * M_S2_PER_CODE
    }

    /// Whether the code is at or beyond the end of the specified range, so that the acceleration may be larger.
    pub const fn is_clipped(self) -> bool {
        self.0 >= FULL_SCALE_CODE || self.0 <= -FULL_SCALE_CODE
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn reference_data_sheet_scale() {
        assert_eq!(SensorCode::new(12_800).to_m_s2(), 9.80665);
        assert!((M_S2_PER_CODE - 7.661_445e-4).abs() < 1e-10);
    }

    #[test]
    fn analytic_register_words_are_sign_extended() {
        assert_eq!(SensorCode::from_bits(0xF_FFFF).get(), -1);
        assert_eq!(SensorCode::from_bits(0x8_0000), SensorCode::MIN);
        assert_eq!(SensorCode::from_bits(0x7_FFFF), SensorCode::MAX);
        assert_eq!(SensorCode::from_bits(0xABC0_0001).get(), 1, "bits above 20 are ignored");
    }

    #[test]
    fn analytic_saturates_and_flags_clipping() {
        assert_eq!(SensorCode::from_m_s2(1e9).get(), FULL_SCALE_CODE);
        assert_eq!(SensorCode::from_m_s2(-1e9).get(), -FULL_SCALE_CODE);
        assert_eq!(SensorCode::from_m_s2(f64::NAN).get(), 0);
        assert!(SensorCode::from_m_s2(392.3).is_clipped());
        assert!(!SensorCode::from_m_s2(392.0).is_clipped());
    }

    proptest! {
        #[test]
        fn property_round_trip(code in -FULL_SCALE_CODE..=FULL_SCALE_CODE) {
            let code = SensorCode::new(code);
            prop_assert_eq!(SensorCode::from_m_s2(f64::from(code.to_m_s2())), code);
        }
    }
}
