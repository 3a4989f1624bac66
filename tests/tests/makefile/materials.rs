//! Meshes several materials with make, up to the tetrahedra. Checks independently which labels the
//! mesh preserves.

use super::make;
use super::support::{root, run, skip};
use glam::{DMat3, DVec3};
use isoparticles_tests::nrrd::{self, FileSpace, Voxels};
use isoparticles_volume::Geometry;
use std::path::Path;
use std::process::Command;

/// Writes a label map on an oblique left-handed grid: a ball of two halves (labels 1 and 2) in a
/// block (label 3).
fn write_halves(path: &Path) {
    let mut geometry = Geometry::axis_aligned([20, 19, 18], DVec3::new(1.0, 1.1, 1.2));
    geometry.directions = DMat3::from_rotation_z(0.4) * DMat3::from_rotation_x(-0.3);
    geometry.directions.x_axis = -geometry.directions.x_axis;
    geometry.origin = DVec3::new(-40.0, 12.0, 300.0);
    let label = |n: usize| {
        let at = [n % 20, n / 20 % 19, n / (20 * 19)];
        let p = DVec3::from_array(at.map(|n| n as f64)) * geometry.spacing;
        let is_ball = p.distance(DVec3::new(9.6, 9.8, 10.3)) < 6.2;
        let is_block = (0..3).all(|axis| (1..geometry.size[axis] - 1).contains(&at[axis]));
        if is_ball { 1 + u8::from(at[0] > 9) } else { 3 * u8::from(is_block) }
    };
    let labels = (0..geometry.voxel_count()).map(label).collect();
    nrrd::write(path, &geometry, FileSpace::Ras, &Voxels::U8(labels), true).expect("written");
}

#[test]
fn materials_become_one_mesh_that_keeps_every_voxel() {
    let test = "materials_become_one_mesh_that_keeps_every_voxel";
    let python = root().join(".venv/bin/python");
    if !python.exists() {
        return skip(test, &format!("{} is not there (make env)", python.display()));
    }
    let folder = tempfile::tempdir().expect("folder");
    let volume = folder.path().join("halves.nrrd");
    write_halves(&volume);
    let mut command = make();
    command.args(["mesh", "MATERIALS=left:1,right:2,rest:3", "SIZE=1.2", "SCALE=0", "VERBOSITY=-q"]);
    // The chord error of edges longer than a voxel could cut off voxel centres near the surface.
    // The clearance keeps the surface far enough from them.
    command.arg("DISTFIELD_OPTIONS=--clearance 0.1");
    command.arg("TETMESH_OPTIONS=--source left --conductivity right=0.2");
    command.arg(format!("INPUT={}", volume.display())).arg(format!("OUT={}", folder.path().display()));
    run(&mut command).expect_success("make mesh MATERIALS=...");
    let file = |ending: &str| folder.path().join("halves").join(format!("halves.{ending}"));
    let report: serde_json::Value =
        serde_json::from_slice(&std::fs::read(file("report.json")).expect("the report")).expect("JSON");
    assert_eq!(report["outcome"], "passed", "{report}");

    let labels = folder.path().join("labels.vti");
    let mut command = Command::new(super::binaries().join("isoparticles-volume"));
    command.arg("convert").arg(&volume).arg("-o").arg(&labels).arg("-q");
    run(&mut command).expect_success("the labels");
    let json = folder.path().join("kept.json");
    let look = |surface: &Path| {
        let mut command = Command::new(&python);
        command.arg(root().join("tests/check_materials.py")).arg(surface).arg(&labels);
        command.arg("--volume").arg(file("volume.vtu")).arg("--json").arg(&json);
        run(&mut command)
    };
    look(&file("surface.vtp")).expect_success("check_materials.py");
    let kept: serde_json::Value = serde_json::from_slice(&std::fs::read(&json).expect("figures")).expect("JSON");
    let figure = |name: &str| kept[name].as_f64().unwrap_or(f64::NAN);
    assert_eq!((figure("junctions_lost"), figure("junctions_kept_percent")), (0.0, 100.0), "{kept}");
    assert!(figure("contacts_interrupted") == 0.0 && figure("contacts") > 100.0, "{kept}");
    assert!(figure("radius_ratio_smallest") > 0.45 && figure("radius_ratio_mean") > 0.95, "{kept}");
    assert!(figure("angle_smallest") > 22.0 && figure("dihedral_smallest") > 8.0, "{kept}");

    // This volume has different labels from the mesh.
    let other = folder.path().join("other.nrrd");
    let geometry = Geometry::axis_aligned([20, 19, 18], DVec3::new(1.0, 1.1, 1.2));
    nrrd::write(&other, &geometry, FileSpace::Lps, &Voxels::U8(vec![3; geometry.voxel_count()]), true)
        .expect("written");
    std::fs::remove_file(&labels).expect("removed");
    let mut command = Command::new(super::binaries().join("isoparticles-volume"));
    command.arg("convert").arg(&other).arg("-o").arg(&labels).arg("-q");
    run(&mut command).expect_success("other labels");
    let ended = look(&file("surface.vtp"));
    assert_eq!(ended.code, Some(1), "{}", ended.stdout);
    assert!(
        ended.stdout.contains("DIFFERS: ") && ended.stdout.contains("voxels_changed"),
        "{}{}",
        ended.stdout,
        ended.stderr
    );
}
