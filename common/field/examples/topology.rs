//! Prints the topology of F = 0 in each of the given distance fields, and the computing time. Also
//! prints digests of all results, to compare two builds of the code. Usage: `cargo run --release -p
//! isoparticles-field --example topology -- F.vti [more.vti]`.

use isoparticles_field::spline::CubicSpline;
use isoparticles_field::topology::FieldTopology;
use isoparticles_volume::{Image, read_volume};
use std::hash::{DefaultHasher, Hash, Hasher};
use std::path::Path;
use std::time::Instant;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    for name in std::env::args().skip(1) {
        let volume = read_volume(Path::new(&name))?;
        let image = Image { geometry: volume.geometry, data: volume.voxels.to_f32() };
        let field = CubicSpline::new(&image);
        let start = Instant::now();
        let topology = FieldTopology::new(&field);
        let seconds = start.elapsed().as_secs_f64();
        let samples: Vec<_> = (0..topology.components().len() as u32).map(|c| topology.samples(c)).collect();
        let place = |p: &glam::DVec3| {
            let (_, normal) = field.value_gradient(*p);
            topology.component_at(&field, *p, normal)
        };
        // projects every hundredth sample onto F = 0 and looks up its component
        let every = samples.iter().flatten().step_by(100);
        let found: Vec<_> = every.filter_map(|p| field.project(*p, 1.0, 1e-9)).map(|p| place(&p)).collect();
        let summary = topology.summary();
        println!(
            "{:<40} {seconds:7.3} s  {} components {:?}, Euler {} {:?}, {} undecided, {} critical points",
            Path::new(&name).file_name().unwrap_or_default().display(),
            summary.components,
            summary.components_between,
            summary.euler,
            summary.euler_between,
            summary.undecided.len(),
            topology.critical_points().len(),
        );
        println!(
            "    components {:016x} groups {:016x} undecided {:016x} critical {:016x} samples {:016x} found {:016x}",
            digest(&format!("{:?}", topology.components())),
            digest(&format!("{:?}", topology.groups())),
            digest(&format!("{:?}", topology.undecided())),
            digest(&format!("{:?}", topology.critical_points())),
            digest(&format!("{samples:?}")),
            digest(&format!("{found:?}")),
        );
    }
    Ok(())
}

/// Returns a hash of debug output. Floats are printed at full precision, so results with equal
/// output are equal bit for bit.
fn digest(text: &str) -> u64 {
    let mut hasher = DefaultHasher::new();
    text.hash(&mut hasher);
    hasher.finish()
}
