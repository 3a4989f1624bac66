//! Tests of the kernels against their CPU twins. Those that need an adapter take the first one there is, lavapipe as well, and
//! say so when there is none.

mod density;
mod fields;
mod lists;
mod materials;
mod passes;
mod scans;
mod shaders;

use super::adapter::{Choice, Gpu, adapters};

/// The first adapter, or `None` with a line that says what is skipped.
fn any_gpu(what: &str, choice: Choice) -> Option<Gpu> {
    let Some(first) = adapters().into_iter().next() else {
        isoparticles_tests::skip::skip(what, "no Vulkan, Metal or DX12 adapter (Mesa's lavapipe would do)");
        return None;
    };
    Some(Gpu::open(&Choice { name: Some(first.name), ..choice }).unwrap())
}
