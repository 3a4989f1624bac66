//! Meshes several materials with make, up to the tetrahedra. Checks independently which labels the
//! mesh preserves.

use super::make;
use super::support::{root, run, skip};
use glam::{DMat3, DVec3};
use isoparticles_tests::nrrd::{self, FileSpace, Voxels};
use isoparticles_volume::{Geometry, read_volume};
use std::collections::BTreeMap;
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

/// Writes twelve overlapping masks: three slabs of each of the four tissues of the torso phantom,
/// grown by a voxel. Returns the voxels of each mask by name.
fn write_organs(folder: &Path) -> BTreeMap<String, Vec<bool>> {
    let torso = folder.with_extension("nrrd");
    let mut phantom = Command::new(super::binaries().join("phantom"));
    phantom.args(["torso", "--kind", "label", "--size", "67,33,45", "--spacing", "5.2", "-o"]).arg(&torso);
    run(&mut phantom).expect_success("the phantom");
    let volume = read_volume(&torso).expect("the phantom");
    let [nx, ny, nz] = volume.geometry.size;
    std::fs::create_dir(folder).expect("a folder");
    let organ = |organ: usize| {
        let (tissue, slab) = (1 + organ as i64 / 3, organ % 3);
        let tissue = volume.voxels.label_mask(&[tissue]);
        let is_inside = |n: usize| {
            let [i, j, k] = [n % nx, n / nx % ny, n / (nx * ny)];
            let is_near = || (i.saturating_sub(1)..(i + 2).min(nx)).any(|i| tissue[volume.geometry.linear(i, j, k)]);
            (slab * nz / 3..(slab + 1) * nz / 3 + 2).contains(&k) && is_near()
        };
        let inside: Vec<bool> = (0..nx * ny * nz).map(is_inside).collect();
        let name = format!("organ_{organ}");
        let voxels = Voxels::U8(inside.iter().map(|&inside| u8::from(inside)).collect());
        nrrd::write(&folder.join(format!("{name}.nrrd")), &volume.geometry, FileSpace::Ras, &voxels, true)
            .expect("written");
        (name, inside)
    };
    (0..12).map(organ).collect()
}

#[test]
fn a_folder_of_overlapping_masks_becomes_one_mesh() {
    let folder = tempfile::tempdir().expect("folder");
    let organs = write_organs(&folder.path().join("organs"));
    let mut command = make();
    // slabs of ribs are too thin for these edges
    command.args(["surface", "MATERIALS=organ_5,organ_0,all", "SIZE=12", "ACCEPT_LOSSES=yes", "ACCEPT_FORCED=yes"]);
    command.arg("VERBOSITY=-q");
    command.arg(format!("INPUT={}", folder.path().join("organs").display()));
    command.arg(format!("OUT={}", folder.path().join("out").display()));
    run(&mut command).expect_success("make surface INPUT=organs/");

    let mut order: Vec<&str> = organs.keys().map(String::as_str).collect();
    let voxels = |name: &str| organs[name].iter().filter(|&&inside| inside).count();
    order.sort_by_key(|name| match *name {
        "organ_5" => 0,
        "organ_0" => 1,
        name => 2 + voxels(name),
    });
    let mut expected: BTreeMap<(&str, &str), usize> = BTreeMap::new();
    (0..organs["organ_0"].len()).for_each(|voxel| {
        let mut owners = order.iter().copied().filter(|name| organs[*name][voxel]);
        let kept = owners.next().unwrap_or_default();
        owners.for_each(|lost| *expected.entry((kept, lost)).or_default() += 1);
    });
    let report = folder.path().join("out/organs/reports/distfield.json");
    let report: serde_json::Value = serde_json::from_slice(&std::fs::read(report).expect("the report")).expect("JSON");
    let pairs = report["results"]["overlaps"].as_array().expect("overlaps");
    let text = |pair: &serde_json::Value, key: &str| pair[key].as_str().expect("a name").to_owned();
    let told = pairs.iter().map(|pair| ((text(pair, "kept"), text(pair, "lost")), pair["voxels"].as_u64()));
    let expected =
        expected.iter().map(|(&(kept, lost), &voxels)| ((kept.to_owned(), lost.to_owned()), Some(voxels as u64)));
    assert!(pairs.len() >= 12, "{report}");
    assert_eq!(told.collect::<BTreeMap<_, _>>(), expected.collect());
}
