//! Reads and writes the subset of VTK's XML formats that this project needs: a single piece, point
//! and cell arrays, and field data.
//!
//! Files are written with raw appended data, which preserves all values exactly and can be read by
//! VTK, ParaView and PyVista. The reader supports all variants that these programs write: ASCII,
//! base64 and raw data; no compression or zlib; both byte orders; 32- and 64-bit headers.
//!
//! The crate vtkio (0.7.0-rc2) is not used here: it stores origin and spacing as 32-bit floats,
//! supports neither `Direction` nor field data, and its XML part needs quick-xml 0.36
//! (RUSTSEC-2026-0194, -0195).

mod decode;
mod element;
mod write;

pub use element::{Element, VtkFile};
pub use write::{Document, Payload, ascii_json};

use crate::voxels::ScalarType;

/// Returns VTK's name of a scalar type.
fn vtk_name(scalar: ScalarType) -> &'static str {
    match scalar {
        ScalarType::I8 => "Int8",
        ScalarType::U8 => "UInt8",
        ScalarType::I16 => "Int16",
        ScalarType::U16 => "UInt16",
        ScalarType::I32 => "Int32",
        ScalarType::U32 => "UInt32",
        ScalarType::I64 => "Int64",
        ScalarType::U64 => "UInt64",
        ScalarType::F32 => "Float32",
        ScalarType::F64 => "Float64",
    }
}

/// Returns the scalar type that has the given VTK name.
fn scalar_of(name: &str) -> Option<ScalarType> {
    use ScalarType::{F32, F64, I8, I16, I32, I64, U8, U16, U32, U64};
    [I8, U8, I16, U16, I32, U32, I64, U64, F32, F64].into_iter().find(|&scalar| vtk_name(scalar) == name)
}
