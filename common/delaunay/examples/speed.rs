//! Measures the time and memory per point of the Delaunay triangulation on five point sets.
//!
//! ```text
//! cargo run --release -p isoparticles-delaunay --example speed [POINTS]
//! ```
//!
//! Prints one line per point set. Each set has 100,000 points by default. Large sets are
//! triangulated on all cores. Set `RAYON_NUM_THREADS=1` to measure one thread.

use glam::DVec3;
use isoparticles_delaunay::Delaunay;
use isoparticles_field::random::uniform;
use std::f64::consts::TAU;
use std::time::Instant;

fn main() {
    let count = std::env::args().nth(1).and_then(|n| n.parse().ok()).unwrap_or(100_000u64);
    let u = |stream: u64, n: u64| uniform(11, stream, n);
    let cube = |n: u64| DVec3::new(u(0, n), u(1, n), u(2, n)) * 100.0;
    let sphere = |n: u64| {
        let (z, angle) = (2.0 * u(0, n) - 1.0, TAU * u(1, n));
        let r = (1.0 - z * z).sqrt();
        DVec3::new(r * angle.cos(), r * angle.sin(), z) * 100.0
    };
    let torus = |n: u64| {
        let (a, b) = (TAU * u(0, n), TAU * u(1, n));
        DVec3::new((60.0 + 25.0 * b.cos()) * a.cos(), (60.0 + 25.0 * b.cos()) * a.sin(), 25.0 * b.sin())
    };
    // a golden-angle spiral on a bumpy ball gives evenly spaced points, like settled particles
    let bumpy = |n: u64| {
        let (z, angle) = (1.0 - (2.0 * n as f64 + 1.0) / count as f64, n as f64 * TAU * 0.618_033_988_749_894_9);
        let (r, bump) = ((1.0 - z * z).sqrt(), 1.0 + 0.2 * (5.0 * z).sin() * (4.0 * angle).cos() * (1.0 - z * z));
        DVec3::new(r * angle.cos(), r * angle.sin(), z) * 100.0 * bump
    };
    let side = (count as f64).cbrt().ceil() as u64;
    let grid = |n: u64| DVec3::new((n % side) as f64, (n / side % side) as f64, (n / side / side) as f64);
    let sets: [(&str, &dyn Fn(u64) -> DVec3); 5] =
        [("bumpy", &bumpy), ("cube", &cube), ("sphere", &sphere), ("torus", &torus), ("grid", &grid)];
    for (name, point) in sets {
        let points: Vec<DVec3> = (0..count).map(point).collect();
        let start = Instant::now();
        match Delaunay::new(&points) {
            Ok(d) => {
                let seconds = start.elapsed().as_secs_f64();
                let memory = d.memory();
                println!(
                    "{name:>7}: {count} points, {seconds:.3} s, {:.2} us a point, {:.2} cells and {:.0} bytes a point",
                    seconds * 1e6 / count as f64,
                    memory.tetrahedra as f64 / count as f64,
                    memory.bytes as f64 / count as f64
                );
            }
            Err(error) => println!("{name:>7}: {error}"),
        }
    }
}
