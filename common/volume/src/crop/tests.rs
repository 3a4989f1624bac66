use super::*;
use crate::geometry::Space;
use crate::nrrd::{Encoding, write_nrrd};
use crate::voxels::Voxels;
use glam::{DMat3, DQuat};

fn crop(text: &str) -> Crop {
    text.parse().expect(text)
}

fn grid() -> Geometry {
    let origin = DVec3::new(-10.0, 0.5, 300.0);
    Geometry { origin, ..Geometry::axis_aligned([20, 30, 40], DVec3::new(1.0, 0.5, 2.0)) }
}

fn located(text: &str, geometry: &Geometry) -> [[usize; 3]; 2] {
    let found = crop(text).locate(Path::new("v.nrrd"), geometry).expect(text);
    [found.low, found.high]
}

#[test]
fn boxes_keep_the_voxels_with_their_centre_inside() {
    assert_eq!(located("voxels:2..5,..,7..", &grid()), [[2, 0, 7], [5, 29, 39]]);
    assert_eq!(located("voxels:0..999,..3,..", &grid()), [[0; 3], [19, 3, 39]]);
    assert_eq!(located("mm:-8.5..-5,..,310..", &grid()), [[2, 0, 5], [5, 29, 39]]);
    assert_eq!(located("mm:-1e3..1e3,0.5..1.0,..302", &grid()), [[0; 3], [19, 1, 1]]);
    // 0.1 + 0.2 > 0.3
    let fine = Geometry::axis_aligned([9; 3], DVec3::splat(0.1));
    assert_eq!(located("mm:0..0.3,..,..", &fine), [[0; 3], [3, 8, 8]]);
}

#[test]
fn oblique_grids_keep_the_smallest_box_around_these_voxels() {
    let turn = DMat3::from_quat(DQuat::from_euler(glam::EulerRot::XYZ, 0.3, -0.4, 0.6));
    let flip = DMat3::from_cols(-DVec3::X, DVec3::Z, DVec3::Y);
    for directions in [turn, flip, turn * flip] {
        let geometry = Geometry { directions, ..grid() };
        let centre = geometry.grid_to_world(0.5 * geometry.upper_corner());
        let ends = [centre - DVec3::new(6.1, 4.2, 8.3), centre + DVec3::new(7.1, 5.2, 9.3)];
        let inside = |n: usize| {
            let p = geometry.grid_to_world(geometry.node_to_grid(n));
            p.cmpge(ends[0]).all() && p.cmple(ends[1]).all()
        };
        let mut wanted = [[usize::MAX; 3], [0; 3]];
        for n in (0..geometry.voxel_count()).filter(|&n| inside(n)) {
            let index = [n % 20, n / 20 % 30, n / 600];
            wanted = [[0, 1, 2].map(|a| wanted[0][a].min(index[a])), [0, 1, 2].map(|a| wanted[1][a].max(index[a]))];
        }
        let found = Crop::World(ends.map(|end| end.to_array())).locate(Path::new("v.nrrd"), &geometry).expect("a box");
        assert_eq!([found.low, found.high], wanted);
        assert!(found.size() != geometry.size, "cut");
    }
}

#[test]
fn masks_keep_the_box_around_their_voxels() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("mask.nrrd");
    let mask = |geometry: &Geometry, inside: &[[usize; 3]]| {
        let mut voxels = vec![0.0; geometry.voxel_count()];
        inside.iter().for_each(|&[i, j, k]| voxels[geometry.linear(i, j, k)] = 0.5);
        voxels[geometry.linear(0, 0, 0)] = f32::NAN;
        write_nrrd(&path, geometry, &Voxels::F32(voxels), Encoding::Gzip).expect("written");
    };
    let name = path.to_str().expect("text");
    mask(&grid(), &[[3, 9, 4], [5, 7, 8]]);
    assert_eq!(located(name, &grid()), [[3, 7, 4], [5, 9, 8]]);
    // voxels twice as large, the first of which covers eight voxels; the axes y and z are exchanged
    let coarse = Geometry {
        directions: DMat3::from_cols(DVec3::X, DVec3::Z, DVec3::Y),
        origin: grid().origin + DVec3::new(0.5, 0.25, 1.0),
        ..Geometry::axis_aligned([10, 20, 15], DVec3::new(2.0, 4.0, 1.0))
    };
    mask(&coarse, &[[1, 2, 3], [2, 3, 3]]);
    assert_eq!(located(name, &grid()), [[2, 6, 4], [5, 7, 7]]);
    let error =
        |geometry: &Geometry| crop(name).locate(Path::new("v.nrrd"), geometry).expect_err("refused").to_string();
    assert!(error(&Geometry { space: Space::Lps, ..grid() }).contains("not in the same space as v.nrrd"));
    assert!(error(&Geometry { origin: DVec3::ZERO, ..grid() }).contains("no voxel centre"));
    mask(&coarse, &[]);
    assert!(error(&grid()).contains("no voxel other than 0"));
}

#[test]
fn regions_outside_the_volume_are_refused() {
    let refused = |text: &str| crop(text).locate(Path::new("v.nrrd"), &grid()).expect_err(text);
    for text in ["mm:-20..-11,..,..", "mm:0.2..0.8,..,..", "voxels:20..,..,..", "mm:..,..,500.."] {
        let error = refused(text);
        assert!(error.to_string().contains("no voxel centre"), "{error}");
        assert!(error.remedy().contains("mm:-10.000..9.000,0.500..15.000,300.000..378.000"), "{}", error.remedy());
        assert!(error.remedy().contains("voxels:0..19,0..29,0..39"), "{}", error.remedy());
    }
    assert!(refused("voxels:..,4..4,..").to_string().contains("one voxel along the second axis"));
}

#[test]
fn regions_are_written_as_they_are_read() {
    for text in ["mm:-8.5..5,..,..310", "voxels:2..5,..,7..", "a folder/lungs.nii.gz", "mm-1.nrrd"] {
        assert_eq!(crop(text).to_string(), text);
    }
    assert_eq!(crop("mm: 1 .. 2 , .. , 1e1 .."), crop("mm:1..2,..,10.."));
    for (text, told) in [
        ("", "names no region"),
        ("1..2,..,5..", "mm:1..2,..,5.. in mm, or voxels:1..2,..,5.."),
        ("mm:1..2", "has 1 ranges"),
        ("mm:1..2,3,4..5", "'3' is not a range"),
        ("mm:1..NaN,..,..", "'NaN' is not a number of mm"),
        ("mm:..inf,..,..", "'inf' is not a number of mm"),
        ("mm:3..2,..,..", "'3..2' ends before it starts"),
        ("voxels:1.5..2,..,..", "'1.5' is not the number of a voxel"),
        ("voxels:-1..2,..,..", "'-1' is not the number of a voxel"),
        ("voxels:1..,..,..,..", "has 4 ranges"),
    ] {
        let error = text.parse::<Crop>().expect_err(text);
        assert!(error.contains(told), "{text}: {error}");
    }
}
