//! Tests of the kernels against their CPU twins. Tests that need an adapter use the first adapter,
//! which may be a software renderer such as lavapipe. Without an adapter they print that they are
//! skipped.

mod density;
mod fields;
mod lists;
mod materials;
mod passes;
mod scans;
mod shaders;

use super::adapter::{AdapterChoice, Gpu, adapters};

/// Opens the first adapter. If there is no adapter, prints what is skipped and returns `None`.
fn any_gpu(what: &str, choice: AdapterChoice) -> Option<Gpu> {
    let Some(first) = adapters().into_iter().next() else {
        isoparticles_tests::skip::skip(what, "no Vulkan, Metal or DX12 adapter (Mesa's lavapipe would do)");
        return None;
    };
    Some(Gpu::open(&AdapterChoice { name: Some(first.name), ..choice }).unwrap())
}
