//! Runs the program on several materials. Tests that particles lie on their strata, that curves are
//! evenly divided, that interfaces are covered, and that the output is byte-identical for any
//! number of threads.

use glam::DVec3;
use isoparticles_field::materials::{
    Analytic, Indicator, Indicators, Material, MaterialId, Materials, Stratum, ball, half_space, maximum, minimum,
    negative,
};
use isoparticles_field::particle_set::{ParticleSet, Strata};
use isoparticles_stage::field_file::{Field, FieldKind};
use isoparticles_stage::materials_file::{MaterialsFile, Shown};
use isoparticles_stage::particle_file::{ParticleKind, read_particles};
use isoparticles_volume::{Geometry, Image};
use serde_json::json;
use std::path::Path;
use std::process::Command;

const CENTRE: DVec3 = DVec3::new(12.1, 11.8, 12.3);
const H: f64 = 1.2;

/// Returns the indicators of three sectors of a ball of radius 8 mm. The ball has two junction
/// points, four junction curves between them, and six interfaces.
fn sectors() -> Analytic {
    let normal = |turns: f64| {
        let angle = turns * std::f64::consts::TAU;
        DVec3::new(-angle.sin(), angle.cos(), 0.0)
    };
    let sector = |n: f64| {
        let wedge = maximum(half_space(CENTRE, -normal(n / 3.0)), half_space(CENTRE, normal((n + 1.0) / 3.0)));
        maximum(ball(CENTRE, 8.0), wedge)
    };
    Analytic::new(vec![negative(ball(CENTRE, 8.0)), sector(0.1), sector(1.1), sector(2.1)], 1.0)
}

/// Returns the indicators of two balls of radius 5 mm and a separate ball of radius 2 mm. The two
/// balls meet in a disc of radius 3 mm, whose boundary is a closed junction curve of three
/// interfaces.
fn balls() -> Analytic {
    let way = DVec3::new(2.0, -1.0, 1.5).normalize();
    let half = |way: DVec3| maximum(ball(CENTRE + 4.0 * way, 5.0), half_space(CENTRE, -way));
    let apart = || ball(DVec3::splat(3.5), 2.0);
    let outside = negative(minimum(minimum(half(way), half(-way)), apart()));
    Analytic::new(vec![outside, half(way), half(-way), apart()], 1.0)
}

fn sampled(analytic: &Analytic) -> Materials {
    let geometry = Geometry::axis_aligned([25; 3], DVec3::ONE);
    let of = |id: MaterialId| {
        let image = Image::sampled(geometry.clone(), |p| analytic.jet(id, p).value as f32);
        let (indicator, negative) = Indicator::new(&image, [0; 3], geometry.size, false);
        (Material { name: format!("m{}", id.0), labels: Vec::new() }, indicator, negative)
    };
    Materials::new(geometry.clone(), analytic.ids().map(of).collect()).expect("parts of one grid")
}

/// Runs the program on materials with a constant h. Returns the seeds, their strata and the bytes
/// of the output file.
fn seeds(folder: &Path, materials: &Materials, more: &[&str]) -> (ParticleSet, Strata, Vec<u8>) {
    let at = |name: &str| folder.join(name).to_str().expect("text").to_owned();
    let [input, sizes, output] = ["case.materials.vti", "case.sizefield.vti", "case.seeds.bin"].map(at);
    let geometry = materials.geometry();
    let (material, interface_distance) = (vec![0; geometry.voxel_count()], vec![0.0; geometry.voxel_count()]);
    let (materials, shown) = (materials.clone(), Shown { material, interface_distance });
    let h = Image::filled(geometry.clone(), H as f32);
    let meta = json!({});
    let sizing = Field { image: h.into(), meta: meta.clone(), history: None, kind: FieldKind::Sizing };
    sizing.write(Path::new(&sizes)).expect("written");
    MaterialsFile { materials, shown, meta, history: None }.write(Path::new(&input)).expect("written");
    let arguments = [&[input.as_str(), &sizes, "-o", &output, "--force", "--quiet"], more].concat();
    let run = Command::new(env!("CARGO_BIN_EXE_seed")).args(arguments).output().expect("the program runs");
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    let file = read_particles(Path::new(&output), &[ParticleKind::Seeds]).expect("read");
    (file.particles, file.strata.expect("of many materials"), std::fs::read(&output).expect("read"))
}

/// Asserts that every particle lies on its stratum, that no other material is nearer, that the
/// particles are ordered by dimension, and that the normals are correct.
fn are_on_their_strata(materials: &Materials, particles: &ParticleSet, strata: &Strata) {
    assert_eq!(particles.positions.len(), strata.of.len());
    assert!(strata.of.is_sorted_by_key(|stratum| stratum.dimension()));
    for (n, stratum) in strata.of.iter().enumerate() {
        let (p, normal, own) = (particles.positions[n], particles.normals[n], stratum.materials());
        let values: Vec<f64> = own.iter().map(|&id| materials.value_gradient(id, p).0).collect();
        let tolerance = if stratum.dimension() == 2 { 1e-5 } else { 1e-6 };
        assert!(values.iter().all(|value| (value - values[0]).abs() < tolerance), "{stratum:?} at {p}: {values:?}");
        assert!(materials.clearance(p, own) >= -1e-6, "{stratum:?} at {p}");
        match *own {
            [low, high] => {
                let gradient = materials.difference_gradient(high, low, p).1.normalize();
                assert!(normal.distance(gradient) < 1e-9);
                let ahead = materials.value_gradient(low, p + 0.1 * normal).0;
                assert!(ahead < materials.value_gradient(high, p + 0.1 * normal).0, "{stratum:?} at {p}");
            }
            [first, second, _] => {
                assert!((normal.length() - 1.0).abs() < 1e-9);
                assert!(normal.dot(materials.difference_gradient(first, second, p).1).abs() < 1e-9);
            }
            _ => assert_eq!(normal, DVec3::ZERO),
        }
    }
    assert!(particles.energies.iter().all(|&energy| energy == 0.0));
}

/// Asserts that the steps along curves are about h long, and that two steps end at each particle on
/// a curve and four at each junction point.
fn curves_are_even(particles: &ParticleSet, strata: &Strata) {
    let mut degrees = vec![0; strata.of.len()];
    for &[a, b] in &strata.segments {
        let length = particles.positions[a as usize].distance(particles.positions[b as usize]);
        assert!((0.75..1.3).contains(&(length / H)), "{a} {b}: {length}");
        degrees[a as usize] += 1;
        degrees[b as usize] += 1;
    }
    for (degree, stratum) in degrees.iter().zip(&strata.of) {
        assert_eq!(*degree, [4, 2, 0][stratum.dimension()], "{stratum:?}");
    }
}

#[test]
fn sectors_of_a_ball_are_seeded_from_points_to_interfaces() {
    let folder = tempfile::tempdir().expect("folder");
    let materials = sampled(&sectors());
    let (particles, strata, bytes) = seeds(folder.path(), &materials, &["--threads", "1"]);
    are_on_their_strata(&materials, &particles, &strata);
    curves_are_even(&particles, &strata);
    let of = |dimension: usize| strata.of.iter().filter(|stratum| stratum.dimension() == dimension).count();
    assert_eq!(of(0), 2);
    // one curve is 16 mm long, and the other three are 8 pi mm long
    let steps = (16.0 / H).round() + 3.0 * (8.0 * std::f64::consts::PI / H).round();
    assert!((of(1) as f64 - (steps - 4.0)).abs() <= 4.0, "{} of {steps}", of(1));
    let area = 64.0 * 4.0 * std::f64::consts::PI + 3.0 * 32.0 * std::f64::consts::PI;
    let expected = 2.0 / 3f64.sqrt() * area / (H * H) - 1.5 * steps;
    assert!((of(2) as f64 / expected - 1.0).abs() < 0.1, "{} of {expected}", of(2));
    // particles on an interface keep their distance from the particles on its border
    for (n, stratum) in strata.of.iter().enumerate().filter(|(_, stratum)| stratum.dimension() == 2) {
        for (m, border) in strata.of.iter().enumerate().filter(|(_, border)| border.dimension() < 2) {
            let distance = particles.positions[n].distance(particles.positions[m]);
            assert!(!border.is_on(stratum) || distance > 0.6 * H, "{distance}");
        }
    }
    assert_eq!(seeds(folder.path(), &materials, &["--threads", "3"]).2, bytes);
}

#[test]
fn closed_curves_are_rings_and_every_component_gets_particles() {
    let folder = tempfile::tempdir().expect("folder");
    let materials = sampled(&balls());
    let (particles, strata, _) = seeds(folder.path(), &materials, &[]);
    are_on_their_strata(&materials, &particles, &strata);
    curves_are_even(&particles, &strata);
    let ring = (6.0 * std::f64::consts::PI / H).round();
    let on_curves = strata.of.iter().filter(|stratum| stratum.dimension() == 1).count();
    assert!((on_curves as f64 - ring).abs() <= 1.0, "{on_curves} of {ring}");
    assert_eq!(strata.segments.len(), on_curves);
    for (a, b) in [(0, 1), (0, 2), (1, 2), (0, 3)] {
        let interface = Stratum::interface(MaterialId(a), MaterialId(b));
        assert!(strata.of.iter().filter(|stratum| **stratum == interface).count() >= 10, "{interface:?}");
    }
}

#[test]
fn a_count_is_kept_to() {
    let folder = tempfile::tempdir().expect("folder");
    let materials = sampled(&sectors());
    let (particles, strata, _) = seeds(folder.path(), &materials, &["--count", "600"]);
    are_on_their_strata(&materials, &particles, &strata);
    assert!((particles.positions.len() as f64 / 600.0 - 1.0).abs() < 0.12, "{}", particles.positions.len());
}

#[test]
fn vertices_of_marching_cubes_are_refused() {
    let folder = tempfile::tempdir().expect("folder");
    seeds(folder.path(), &sampled(&sectors()), &[]);
    let run = Command::new(env!("CARGO_BIN_EXE_seed"))
        .args(["case.materials.vti", "case.sizefield.vti", "-o", "x.bin", "--from", "marching-cubes"])
        .current_dir(folder.path())
        .output()
        .expect("the program runs");
    let text = String::from_utf8_lossy(&run.stderr);
    assert_eq!(run.status.code(), Some(2), "{text}");
    assert!(text.contains("many materials") && text.contains("what to do"), "{text}");
    assert!(!folder.path().join("x.bin").exists());
}
