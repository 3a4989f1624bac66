//! Meshes labelled cubes of a few voxels. Four materials meet along the edges of the cubes, and
//! eight at the corners.

mod support;

use glam::DVec3;
use isoparticles_tests::nrrd::{self, FileSpace, Voxels};
use isoparticles_volume::Geometry;
use support::chain::{self, Wishes};

/// Meshes `count`^3 cubes of `width`^3 voxels, each with its own label. Returns the number of
/// transactions that the optimiser tried.
fn tried(count: usize, width: usize) -> u64 {
    let folder = tempfile::tempdir().expect("folder");
    let (volume, report) = (folder.path().join("cubes.nrrd"), folder.path().join("reconstruct.json"));
    let (margin, side) = (2, count * width);
    let size = side + 2 * margin;
    let label = |n: usize| {
        let place = [n % size, n / size % size, n / (size * size)];
        let is_inside = place.iter().all(|x| (margin..margin + side).contains(x));
        let [x, y, z] = place.map(|x| x.saturating_sub(margin) / width);
        if is_inside { (1 + x + count * (y + count * z)) as u8 } else { 0 }
    };
    let labels = Voxels::U8((0..size.pow(3)).map(label).collect());
    let geometry = Geometry::axis_aligned([size; 3], DVec3::ONE);
    nrrd::write(&volume, &geometry, FileSpace::Lps, &labels, true).expect("a volume");
    let wishes = Wishes {
        distfield: arguments!["--material", "all"],
        particles: arguments!["--backend", "cpu"],
        reconstruct: arguments!["--report", &report],
        ..Wishes::default()
    };
    chain::surface(&volume, folder.path(), &wishes);
    let text = std::fs::read_to_string(&report).expect("a report");
    let report: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    let tried = report["results"]["improve"]["moves"]["tried"].as_u64().expect("a count");
    println!("{count}^3 cubes of {width}^3 voxels: {tried} tried");
    tried
}

#[test]
fn labelled_cubes_pass_all_checks_with_little_work() {
    for (count, width) in [(2, 4), (2, 5), (2, 6), (3, 3), (3, 4)] {
        let tried = tried(count, width);
        assert!(tried < 100_000, "{count}^3 cubes of {width}^3 voxels: {tried} tried");
    }
}
