//! Creates test point sets, and times the Delaunay triangulation of a point file by this crate.
//! `compare.sh` runs this program and `cgal.cpp` on the same points.
//!
//! ```text
//! bench_delaunay points PARTICLES.bin FILE     positions of settled particles
//! bench_delaunay cospherical FILE              integer points exactly on one sphere
//! bench_delaunay sphere N FILE                 random points on a sphere, rounded to doubles
//! bench_delaunay grid N FILE                   N x N x N points of a grid
//! bench_delaunay cube N FILE                   random points in a cube
//! bench_delaunay FILE [THREADS]                triangulates; THREADS 0 or omitted: all cores
//! ```
//! FILE contains little-endian doubles, three per point. The last form prints one line of
//! `key=value` pairs: points, vertices, finite cells, wall-clock seconds of the triangulation
//! (without file reading), CPU seconds summed over all threads, and the increase in peak memory in
//! bytes.

use glam::DVec3;
use isoparticles_delaunay::Delaunay;
use isoparticles_field::random::uniform;
use isoparticles_stage::particle_file::{ParticleKind, read_particles};
use std::path::Path;
use std::process::ExitCode;

/// Squared radius of the sphere of [`cospherical`]: the product of the odd primes up to 23. 64,512
/// points with integer coordinates lie on the sphere.
const SQUARED_RADIUS: i64 = 111_546_435;

type Failure = Box<dyn std::error::Error>;

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    match run(&words) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{error}");
            ExitCode::from(2)
        }
    }
}

fn run(words: &[&str]) -> Result<(), Failure> {
    match words {
        ["points", particles, file] => {
            let kinds = [ParticleKind::Particles, ParticleKind::Seeds];
            write(file, &read_particles(Path::new(particles), &kinds)?.particles.positions)
        }
        ["cospherical", file] => write(file, &cospherical(SQUARED_RADIUS)),
        ["sphere", count, file] => write(file, &sphere(count.parse()?)),
        ["grid", count, file] => write(file, &grid(count.parse()?)),
        ["cube", count, file] => write(file, &cube(count.parse()?)),
        [file] => triangulate(file, 0),
        [file, threads] => triangulate(file, threads.parse()?),
        _ => Err("usage: bench_delaunay FILE [THREADS], or see the head of ours.rs".into()),
    }
}

fn triangulate(file: &str, threads: usize) -> Result<(), Failure> {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build_global()?;
    let points = read(file)?;
    let before = memory("VmRSS:");
    let clock = processor_seconds();
    let start = std::time::Instant::now();
    let delaunay = Delaunay::new(&points)?;
    let seconds = start.elapsed().as_secs_f64();
    let cpu = processor_seconds() - clock;
    let bytes = memory("VmHWM:").saturating_sub(before);
    let cells = delaunay.finite_tetrahedra().count();
    let vertices = delaunay.vertex_count();
    println!(
        "program=isoparticles points={} vertices={vertices} cells={cells} seconds={seconds:.6} cpu={cpu:.6} bytes={bytes}",
        points.len()
    );
    Ok(())
}

/// Returns the value of a field of `/proc/self/status` in bytes, or 0 if the field is missing.
fn memory(key: &str) -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix(key)).unwrap_or_default();
    line.split_whitespace().next().and_then(|number| number.parse::<u64>().ok()).unwrap_or(0) * 1024
}

/// Returns the CPU time of all threads of this process in seconds, with a resolution of 0.01 s.
/// Returns 0 if the time is unknown.
fn processor_seconds() -> f64 {
    let status = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    // The program name in this file is in parentheses and may contain spaces. The 12th and 13th
    // fields after the name are the user and system time in ticks of 0.01 s.
    let after = status.rsplit(')').next().unwrap_or_default();
    after.split_whitespace().skip(11).take(2).filter_map(|ticks| ticks.parse::<f64>().ok()).sum::<f64>() / 100.0
}

fn read(file: &str) -> Result<Vec<DVec3>, Failure> {
    let bytes = std::fs::read(file).map_err(|error| format!("{file}: {error}"))?;
    let point = |&xyz: &[u8; 24]| {
        let (numbers, _) = xyz.as_chunks::<8>();
        DVec3::from_array([0, 1, 2].map(|axis| f64::from_le_bytes(numbers[axis])))
    };
    Ok(bytes.as_chunks::<24>().0.iter().map(point).collect())
}

fn write(file: &str, points: &[DVec3]) -> Result<(), Failure> {
    let bytes: Vec<u8> = points.iter().flat_map(|p| p.to_array()).flat_map(f64::to_le_bytes).collect();
    std::fs::write(file, bytes).map_err(|error| format!("{file}: {error}"))?;
    println!("{}", points.len());
    Ok(())
}

fn cospherical(squared_radius: i64) -> Vec<DVec3> {
    let radius = squared_radius.isqrt();
    let mut points = Vec::new();
    for x in -radius..=radius {
        let most = (squared_radius - x * x).isqrt();
        for y in -most..=most {
            let rest = squared_radius - x * x - y * y;
            let z = rest.isqrt();
            if z * z == rest {
                points.push(DVec3::new(x as f64, y as f64, z as f64));
                if z > 0 {
                    points.push(DVec3::new(x as f64, y as f64, -z as f64));
                }
            }
        }
    }
    points
}

fn sphere(count: u64) -> Vec<DVec3> {
    let on_it = |n| {
        let (z, turn) = (2.0 * uniform(1, 0, n) - 1.0, uniform(1, 1, n) * std::f64::consts::TAU);
        let across = (1.0 - z * z).sqrt();
        DVec3::new(across * turn.cos(), across * turn.sin(), z) * 50.0
    };
    (0..count).map(on_it).collect()
}

fn grid(count: u32) -> Vec<DVec3> {
    let row = |z: u32, y: u32| (0..count).map(move |x| DVec3::new(x.into(), y.into(), z.into()));
    (0..count).flat_map(|z| (0..count).flat_map(move |y| row(z, y))).collect()
}

fn cube(count: u64) -> Vec<DVec3> {
    (0..count).map(|n| DVec3::new(uniform(3, 0, n), uniform(3, 1, n), uniform(3, 2, n))).collect()
}
