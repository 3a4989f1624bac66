//! Tests of neighbour lists, classes and coloured bins.

use super::any_gpu;
use super::fields::{lists, sorted};
use crate::gpu::adapter::AdapterChoice;
use crate::gpu::constants::{BIN_REACH, CLASSES, COLOUR_STRIDE, UNCLASSED};
use crate::gpu::memory::download;
use crate::scenes::Scene;
use crate::settle::{Binning, Engine};
use glam::UVec3;
use isoparticles_field::neighbours::NeighbourLists;

#[test]
fn lists_equal_the_cpu_and_neighbours_differ_in_class() {
    let Some(gpu) = any_gpu("neighbour lists", AdapterChoice::default()) else { return };
    for (scene, binning) in [
        (Scene::ball(1, 1.6), Binning::Graded),
        (Scene::ball(700, 1.6), Binning::Graded),
        (Scene::bumpy_torus(2500), Binning::Graded),
        (Scene::bumpy_torus(2500), Binning::Uniform),
    ] {
        let mut engine = sorted(&gpu, &scene, binning);
        assert!(engine.levels.levels.len() == 1 || binning == Binning::Graded);
        let count = engine.count as usize;
        engine.listed = false;
        let set = engine.particles().unwrap();
        let agree = |i: usize, j: usize| set.normals[i].dot(set.normals[j]) > 0.0;
        let neighbours = NeighbourLists::new(&set.positions, &set.sizes, BIN_REACH, agree);
        let lists = lists(&gpu, &engine);
        let list = |i: usize| &lists[i];
        for i in 0..count {
            let mut found = list(i).to_vec();
            found.sort_unstable();
            let mut want = neighbours.of(i).to_vec();
            want.sort_unstable();
            // the lists may differ only in pairs that rounding can move across a limit
            let edge = |j: &u32| {
                let j = *j as usize;
                let limit = BIN_REACH * set.sizes[i].min(set.sizes[j]);
                let distance = set.positions[i].distance(set.positions[j]);
                (distance / limit - 1.0).abs() < 1e-5 || set.normals[i].dot(set.normals[j]).abs() < 1e-5
            };
            assert!(found.iter().filter(|j| !want.contains(j)).all(edge), "{i}: too many");
            assert!(want.iter().filter(|j| !found.contains(j)).all(edge), "{i}: too few");
        }
        let classes: Vec<u32> = download(&gpu, engine.memory.get("classes"), count).unwrap();
        for i in 0..count {
            assert!(classes[i] == UNCLASSED || list(i).iter().all(|&j| classes[j as usize] != classes[i]), "{i}");
        }
        let given = classes.iter().filter(|&&c| c != UNCLASSED).count();
        // where particles are dense, some particles get no class and do not move until the next
        // sort, so the test requires a class for only 80 %
        assert!(
            given as f64 >= if count < 1000 { 0.995 } else { 0.8 } * count as f64,
            "{given} of {count} particles got a class"
        );
        let class_starts: Vec<u32> = download(&gpu, engine.memory.get("class_starts"), CLASSES as usize + 1).unwrap();
        let ordered: Vec<u32> = download(&gpu, engine.memory.get("class_members"), given).unwrap();
        assert_eq!(class_starts[CLASSES as usize] as usize, given);
        for c in 0..CLASSES as usize {
            let range = class_starts[c] as usize..class_starts[c + 1] as usize;
            assert!(ordered[range].iter().all(|&i| classes[i as usize] == c as u32));
        }
    }
}

#[test]
fn two_bins_of_a_colour_touch_no_common_particle() {
    let Some(gpu) = any_gpu("coloured bins", AdapterChoice::default()) else { return };
    for scene in [Scene::ball(700, 1.6), Scene::bumpy_torus(2500)] {
        let engine = sorted(&gpu, &scene, Binning::Uniform);
        let level = &engine.levels.levels[0];
        let count = engine.count as usize;
        let lists = lists(&gpu, &engine);
        let bins = level.bins.element_product();
        let bin_starts: Vec<u32> = download(&gpu, engine.memory.get("bin_starts"), bins as usize + 1).unwrap();
        let mut touched_by = std::collections::HashMap::new();
        let mut in_lists = 0;
        for bin in 0..bins {
            let at =
                UVec3::new(bin % level.bins.x, bin / level.bins.x % level.bins.y, bin / level.bins.x / level.bins.y);
            let colour = at % COLOUR_STRIDE;
            for i in bin_starts[bin as usize]..bin_starts[bin as usize + 1] {
                let list = &lists[i as usize];
                in_lists += list.len();
                for &j in [i].iter().chain(list) {
                    let other = *touched_by.entry((colour, j)).or_insert(bin);
                    assert_eq!(other, bin, "two bins of colour {colour} touch particle {j}");
                }
            }
        }
        assert!(in_lists > 10 * count, "{in_lists} members of lists: too few for a test");
        assert!(level.bins.max_element() > COLOUR_STRIDE, "{}: every bin has a colour of its own", level.bins);
    }
}
