//! Decodes frames in JPEG and JPEG 2000 to stored numbers in native byte order.

use hayro_jpeg2000::{DecodeSettings, DecoderContext, Image};
use jpeg_decoder::{Decoder, PixelFormat};

/// First bytes of a JPEG 2000 codestream: the markers SOC and SIZ (ISO/IEC 15444-1, section A.5.1).
const START_2000: &[u8] = &[0xff, 0x4f, 0xff, 0x51];
/// Position of the number of components in a codestream. It follows the markers and 36 bytes of
/// sizes, and precedes the number format of the first component.
const COMPONENTS_2000: usize = 40;

/// Decodes a JPEG frame with one component of `columns` x `rows` pixels to numbers of `width`
/// bytes. The error is the reason of a failure.
pub(super) fn decode(frame: &[u8], [columns, rows]: [usize; 2], width: usize) -> Result<Vec<u8>, String> {
    let mut decoder = Decoder::new(frame);
    decoder.set_max_decoding_buffer_size(columns * rows * 2);
    decoder.read_info().map_err(|error| error.to_string())?;
    let info = decoder.info().ok_or("it has no image")?;
    if (usize::from(info.width), usize::from(info.height)) != (columns, rows) {
        return Err(format!(
            "it has {} x {} pixels, and the header declares {columns} x {rows}",
            info.width, info.height
        ));
    }
    match (info.pixel_format, width) {
        (PixelFormat::L8, 1) | (PixelFormat::L16, 2) => decoder.decode().map_err(|error| error.to_string()),
        (PixelFormat::L8, 2) => {
            let bytes = decoder.decode().map_err(|error| error.to_string())?;
            Ok(bytes.into_iter().flat_map(|byte| u16::from(byte).to_ne_bytes()).collect())
        }
        (format, _) => Err(format!("it has pixels of format {format:?}, and the header declares {} bits", 8 * width)),
    }
}

/// Decodes a JPEG 2000 frame like [`decode`].
pub(super) fn decode_2000(frame: &[u8], [columns, rows]: [usize; 2], width: usize) -> Result<Vec<u8>, String> {
    let &[high, low, format] = frame
        .get(COMPONENTS_2000..COMPONENTS_2000 + 3)
        .and_then(|bytes| bytes.first_chunk())
        .filter(|_| frame.starts_with(START_2000))
        .ok_or("it does not start with a JPEG 2000 codestream")?;
    if [high, low] != [0, 1] {
        return Err(format!("it has {} values per pixel", u16::from_be_bytes([high, low])));
    }
    let settings = DecodeSettings { resolve_palette_indices: false, ..DecodeSettings::default() };
    let image = Image::new(frame, &settings).map_err(|error| error.to_string())?;
    if (image.width() as usize, image.height() as usize) != (columns, rows) {
        return Err(format!(
            "it has {} x {} pixels, and the header declares {columns} x {rows}",
            image.width(),
            image.height()
        ));
    }
    let mut context = DecoderContext::default();
    let decoded = image.decode(&mut context).map_err(|error| error.to_string())?;
    let [component] = decoded.components() else { return Err("it is not a grey image".to_owned()) };
    let bits = component.bit_depth();
    if usize::from(bits) > 8 * width || component.samples().len() != columns * rows {
        return Err(format!("it has {bits} bits per pixel, and the header declares {}", 8 * width));
    }
    // the decoder adds 2^(bits - 1) to signed numbers; the highest bit of `format` marks these
    let lowest = if format & 0x80 != 0 { 1i64 << (bits - 1) } else { 0 };
    let highest = (1i64 << bits) - 1;
    let numbers = component.samples().iter().map(|&sample| (sample.round() as i64).clamp(0, highest) - lowest);
    Ok(match width {
        1 => numbers.map(|number| number as u8).collect(),
        2 => numbers.flat_map(|number| (number as u16).to_ne_bytes()).collect(),
        _ => numbers.flat_map(|number| (number as u32).to_ne_bytes()).collect(),
    })
}
