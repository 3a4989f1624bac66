//! Decodes DICOM's run-length encoding (PS3.5, annex G). The bytes of the pixels are stored in
//! separate planes, most significant byte first. Each plane is compressed with PackBits, as in
//! TIFF.
//!
//! This module replaces the decoder of dicom-rs 0.10, which panics on damaged data.

/// Size of the header in bytes (PS3.5, annex G.5): the number of planes and fifteen plane offsets,
/// 4 bytes each.
const HEADER_BYTES: usize = 64;

/// Decodes a frame of `pixels` pixels of `width` bytes each to numbers in native byte order.
/// Returns `None` if the data is damaged.
pub(super) fn decode(frame: &[u8], pixels: usize, width: usize) -> Option<Vec<u8>> {
    let number = |at: usize| Some(u32::from_le_bytes(frame.get(4 * at..4 * at + 4)?.try_into().ok()?) as usize);
    if number(0)? != width || frame.len() < HEADER_BYTES {
        return None;
    }
    let mut values = vec![0; pixels * width];
    for plane in 0..width {
        let start = number(1 + plane)?;
        let end = if plane + 1 < width { number(2 + plane)? } else { frame.len() };
        let bytes = unpack(frame.get(start..end)?, pixels)?;
        let at = if cfg!(target_endian = "little") { width - 1 - plane } else { plane };
        values.chunks_exact_mut(width).zip(bytes).for_each(|(value, byte)| value[at] = byte);
    }
    Some(values)
}

/// Decompresses PackBits data to `count` bytes. A control byte n <= 127 is followed by n + 1
/// literal bytes. A control byte n >= 129 is followed by one byte that is repeated 257 - n times.
/// Returns `None` if the data is too short.
fn unpack(mut packed: &[u8], count: usize) -> Option<Vec<u8>> {
    // two packed bytes expand to at most 128 bytes
    if packed.len().saturating_mul(64) < count {
        return None;
    }
    let mut bytes = Vec::with_capacity(count);
    while bytes.len() < count {
        let (&control, rest) = packed.split_first()?;
        packed = match control {
            0..=127 => {
                let (literal, rest) = rest.split_at_checked(usize::from(control) + 1)?;
                bytes.extend_from_slice(literal);
                rest
            }
            128 => rest,
            129..=255 => {
                let (&repeated, rest) = rest.split_first()?;
                bytes.resize(bytes.len() + 257 - usize::from(control), repeated);
                rest
            }
        };
    }
    bytes.truncate(count);
    Some(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_example_of_tiff_is_unpacked() {
        let packed = [0xfe, 0xaa, 0x02, 0x80, 0x00, 0x2a, 0xfd, 0xaa, 0x03, 0x80, 0x00, 0x2a, 0x22, 0x80, 0xf7, 0xaa];
        let mut expected = vec![0xaa, 0xaa, 0xaa, 0x80, 0x00, 0x2a, 0xaa, 0xaa, 0xaa, 0xaa, 0x80, 0x00, 0x2a, 0x22];
        expected.extend([0xaa; 10]);
        assert_eq!(unpack(&packed, 24), Some(expected));
        assert_eq!(unpack(&packed, 25), None);
        assert_eq!(unpack(&packed[..3], 24), None);
        assert_eq!(unpack(&packed, usize::MAX), None);
    }
}
