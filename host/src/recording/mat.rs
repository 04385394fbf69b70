//! Samples of one passage in a MAT v5 file.

use std::io::Read;

use libflate::zlib::Decoder;
use matfile::{MatFile, NumericData};

use super::check::MAX_SAMPLES;
use super::guard::guarded;
use super::samples::COLUMN;

/// The `matfile` crate calls itself alpha; a damaged file that trips it must not end the program.
pub(super) fn samples(bytes: &[u8]) -> Result<Vec<f32>, String> {
    guarded(|| check_compressed(bytes))??;
    let mat = guarded(|| MatFile::parse(bytes))?.map_err(|e| e.to_string())?;
    let array = mat
        .find_by_name(COLUMN)
        .ok_or_else(|| format!("no numeric array `{COLUMN}`; save it with `save -v7`"))?;
    match array.data() {
        NumericData::Double { real, imag: None } => Ok(real.iter().map(|&a| a as f32).collect()),
        NumericData::Single { real, imag: None } => Ok(real.clone()),
        _ => Err(format!("array `{COLUMN}` is not real floating point, m/s²; convert it before saving")),
    }
}

/// Largest element of a MAT file, bytes: a recording in double precision with its name and size.
const MOST_INFLATED: usize = 8 * MAX_SAMPLES + (64 << 10);
/// Elements of that size in a file: a recording, its times, and more.
const LARGE_ELEMENTS: usize = 4;
/// Header of a MAT v5 file, bytes, and the type of an element that is compressed.
const MAT: (usize, u32) = (128, 15);

/// The `matfile` crate inflates every element of a file whatever its size: 200 kB may hold 200 MB, and a file thousands of them. So
/// their size is counted first. Compressed elements within compressed ones, which no program writes, are not counted but refused.
fn check_compressed(bytes: &[u8]) -> Result<(), String> {
    let big = bytes.get(MAT.0 - 2..MAT.0) == Some(b"MI");
    let u32_at = |k: usize| {
        let word: [u8; 4] = bytes.get(k..k + 4)?.try_into().ok()?;
        Some(if big { u32::from_be_bytes(word) } else { u32::from_le_bytes(word) })
    };
    let (mut at, mut total) = (MAT.0, 0);
    while let Some((kind, content, length)) = element(at, u32_at) {
        let Some(data) = bytes.get(content..content + length) else { break };
        // Elements are filled up to words as long as their tags, but for the compressed ones.
        let filled = length.next_multiple_of(content - at);
        at = content + if kind == MAT.1 { length } else { filled };
        if kind != MAT.1 {
            continue;
        }
        total += check_element(data, big)
            .map_err(|fault| format!("the compressed element at byte {content} {fault}"))?;
        if total > LARGE_ELEMENTS * MOST_INFLATED {
            return Err(format!(
                "more than {} bytes of data; save `{COLUMN}` alone",
                LARGE_ELEMENTS * MOST_INFLATED
            ));
        }
    }
    Ok(())
}

/// Type, begin and length of the element at a byte; small ones have both in one word.
fn element(at: usize, u32_at: impl Fn(usize) -> Option<u32>) -> Option<(u32, usize, usize)> {
    let word = u32_at(at)?;
    match word >> 16 {
        0 => Some((word, at + 8, u32_at(at + 4)? as usize)),
        length => Some((word & 0xffff, at + 4, length as usize)),
    }
}

/// Bytes of a compressed element when it is not.
fn check_element(zlib: &[u8], big: bool) -> Result<usize, String> {
    let damaged = |_| "is damaged; copy the file again".to_string();
    let mut inflated = Decoder::new(zlib).map_err(damaged)?.take(MOST_INFLATED as u64 + 1);
    let mut head = Vec::new();
    inflated.by_ref().take(4).read_to_end(&mut head).map_err(damaged)?;
    let length = head.len() + std::io::copy(&mut inflated, &mut std::io::sink()).map_err(damaged)? as usize;
    if length > MOST_INFLATED {
        return Err(format!(
            "holds more than {MOST_INFLATED} bytes; a file is one train passage: save `{COLUMN}` alone"
        ));
    }
    let word = head.try_into().map_or(0, if big { u32::from_be_bytes } else { u32::from_le_bytes });
    match word & 0xffff == MAT.1 {
        true => Err("holds another one; save it again".into()),
        false => Ok(length),
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use libflate::zlib::Encoder;
    use proptest::prelude::*;

    use super::*;

    /// MAT v5 by its published layout: 128-byte header, then one matrix element of four sub-elements.
    fn mat_v5(name: &str, values: &[f64]) -> Vec<u8> {
        let element = |kind: u32, data: &[u8]| {
            let mut bytes = [kind.to_le_bytes(), (data.len() as u32).to_le_bytes()].concat();
            bytes.extend(data);
            bytes.resize(bytes.len().next_multiple_of(8), 0);
            bytes
        };
        let (double, uint32, int32, int8) = (9, 6, 5, 1);
        let flags = element(uint32, &[6, 0, 0, 0, 0, 0, 0, 0]);
        let size = element(int32, &[1_i32.to_le_bytes(), (values.len() as i32).to_le_bytes()].concat());
        let data: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        let matrix = [flags, size, element(int8, name.as_bytes()), element(double, &data)].concat();
        let mut bytes = format!("{:<124}", "MATLAB 5.0 MAT-file").into_bytes();
        bytes.extend([0x00, 0x01, b'I', b'M']);
        bytes.extend(element(14, &matrix));
        bytes
    }

    /// A MAT v5 file of one compressed element.
    fn compressed(zlib: &[u8]) -> Vec<u8> {
        let mut bytes = mat_v5(COLUMN, &[])[..MAT.0].to_vec();
        bytes.extend([MAT.1.to_le_bytes(), (zlib.len() as u32).to_le_bytes()].concat());
        bytes.extend(zlib);
        bytes
    }

    /// 64 samples with their codes, by zlib 1.2.13.
    const DEFLATED: &str = "78da35904b0a825014864f426211524a4f8a4ced396c033a6c1721d220e801d502da592da125b884060d1a66dcef08faf37d9c8bf73fae\
        886c2c11bb4c474cfe9f2a5c29df946c956f96e7bbc3ee92ddf6e7d3f6b8bdae99affd3f16208ba7499b1ca42623f8f53019e287780b9e\
        931ede377c9fc1428ef013b8480c479cefe31de6167817df81a7f0877b05f8407dc21cbe8377e115e9e0fbfc4ffb160feec9dc487b682f\
        bc8ff7740fba1772880f758fdc4bfb0e74efb0f66de2dbfc4ffb7ee93bc66bdf377b8c39dfc537985be2ebf81e1c3f7f03f0395b";

    fn deflated() -> Vec<u8> {
        (0..DEFLATED.len() / 2)
            .map(|k| u8::from_str_radix(&DEFLATED[2 * k..2 * k + 2], 16).unwrap())
            .collect()
    }

    #[test]
    fn reference_compressed_elements_are_measured_and_read() {
        assert_eq!(check_element(&deflated(), false), Ok(592));
        let found = samples(&compressed(&deflated())).unwrap();
        let exact: Vec<f32> = (0..64).map(|k| (k * 37 % 101) as f32 * 0.25 - 12.0).collect();
        assert_eq!(found, exact);
    }

    /// A stream of an element's type and as many zeros.
    fn zeros(kind: u8, count: usize) -> Vec<u8> {
        let mut encoder = Encoder::new(Vec::new()).unwrap();
        encoder.write_all(&[kind, 0, 0, 0]).unwrap();
        std::io::copy(&mut std::io::repeat(0).take(count as u64), &mut encoder).unwrap();
        encoder.finish().into_result().unwrap()
    }

    /// 200 kB were inflated to any size, and every one of thousands of elements.
    #[test]
    fn regress_elements_that_inflate_beyond_a_recording_are_refused() {
        assert_eq!(check_element(&zeros(14, 258_000), false), Ok(258_004));
        let error = samples(&compressed(&zeros(14, MOST_INFLATED))).unwrap_err();
        assert!(error.contains("at byte 136") && error.contains("more than 32065536 bytes"), "{error}");
        let large = compressed(&zeros(14, MOST_INFLATED - 4));
        let many = [&large[..], &large[MAT.0..].repeat(LARGE_ELEMENTS)].concat();
        let error = samples(&many).unwrap_err();
        assert!(error.contains("alone"), "{error}");
        let nested = samples(&compressed(&zeros(15, 100))).unwrap_err();
        assert!(nested.contains("another one"), "{nested}");
        let cut = samples(&compressed(&deflated()[..60])).unwrap_err();
        assert!(cut.contains("damaged"), "{cut}");
    }

    #[test]
    fn reference_mat_v5_layout() {
        let values = [0.5, -1.25, 100.0];
        assert_eq!(samples(&mat_v5(COLUMN, &values)).unwrap(), [0.5, -1.25, 100.0]);
        assert!(samples(&mat_v5("other", &values)).unwrap_err().contains(COLUMN));
    }

    proptest! {
        #[test]
        fn property_spoilt_mat_never_panics(at in 0_usize..300, with in any::<u8>()) {
            let mut bytes = mat_v5(COLUMN, &[1.0; 12]);
            let at = at % bytes.len();
            bytes[at] = with;
            let _ = samples(&bytes);
        }

        #[test]
        fn property_arbitrary_bytes_never_panic(bytes in proptest::collection::vec(any::<u8>(), 0..600)) {
            let _ = samples(&compressed(&[&[0x78, 0x9c], &bytes[..]].concat()));
            let _ = samples(&bytes);
        }
    }
}
