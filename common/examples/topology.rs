//! Counts what the surface F = 0 of a distance field consists of: `cargo run --release --example topology -- NAME.distfield.vti`.

use isoparticles_common::error::Result;
use isoparticles_common::io::field::{FieldKind, read_field};
use isoparticles_common::spline::CubicSpline;
use isoparticles_common::topology::FieldTopology;
use std::time::Instant;

fn main() -> Result<()> {
    for path in std::env::args().skip(1) {
        let field = CubicSpline::new(&read_field(path.as_ref(), FieldKind::Distance)?.image);
        let start = Instant::now();
        let topology = FieldTopology::new(&field);
        let summary = topology.summary();
        let [least, most] = summary.components_between;
        println!(
            "{path}: {} components ({least} to {most}), Euler characteristic {}, {} critical points, {} undecided places, {:.2} s",
            summary.components,
            summary.euler,
            topology.critical_points().len(),
            summary.undecided.len(),
            start.elapsed().as_secs_f64(),
        );
    }
    Ok(())
}
