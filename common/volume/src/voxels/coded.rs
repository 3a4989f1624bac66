//! Converts the ten scalar types from the byte order of a file to native byte order.

use super::Endian;

/// A number type used in volume files.
pub(super) trait Coded: Sized {
    /// Converts values in place from the byte order of the file to native byte order.
    fn arrange(values: &mut [Self], endian: Endian);
}

macro_rules! coded {
    ($($type:ty),*) => {$(impl Coded for $type {
        fn arrange(values: &mut [Self], endian: Endian) {
            match endian {
                Endian::Little => values.iter_mut().for_each(|value| *value = Self::from_le_bytes(value.to_ne_bytes())),
                Endian::Big => values.iter_mut().for_each(|value| *value = Self::from_be_bytes(value.to_ne_bytes())),
            }
        }
    })*};
}
coded!(i8, u8, i16, u16, i32, u32, i64, u64, f32, f64);
