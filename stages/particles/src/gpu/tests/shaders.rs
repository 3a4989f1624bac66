//! Tests without an adapter: every source is valid WGSL, and its layouts, bindings and constants
//! are the same in Rust and in naga.

use crate::gpu::constants::{Value, constants};
use crate::gpu::levels::BinLevels;
use crate::gpu::parameters::{Block, pass_block, plan_block, run_block, scan_block};
use crate::gpu::shaders::{Access, Variant, bindings, sources};
use glam::{DVec3, Vec3};
use isoparticles_volume::Geometry;
use naga::valid::{Capabilities, ValidationFlags, Validator};
use std::fs;
use std::path::Path;

const VARIANTS: [Variant; 8] = [
    Variant { slabs: false, subgroup_team: None, materials: false },
    Variant { slabs: true, subgroup_team: None, materials: false },
    Variant { slabs: false, subgroup_team: Some(32), materials: false },
    Variant { slabs: false, subgroup_team: Some(16), materials: false },
    Variant { slabs: true, subgroup_team: Some(8), materials: false },
    Variant { slabs: false, subgroup_team: None, materials: true },
    Variant { slabs: true, subgroup_team: Some(16), materials: true },
    Variant { slabs: false, subgroup_team: Some(32), materials: true },
];

fn module(text: &str, what: &str) -> naga::Module {
    naga::front::wgsl::parse_str(text).unwrap_or_else(|error| panic!("{what}: {}", error.emit_to_string(text)))
}

#[test]
fn every_kernel_is_valid() {
    for variant in VARIANTS {
        for source in sources() {
            let text = source.compose(variant);
            let module = module(&text, source.name);
            let capabilities =
                if variant.subgroup_team.is_some() { Capabilities::SUBGROUP } else { Capabilities::empty() };
            let mut validator = Validator::new(ValidationFlags::all(), capabilities);
            validator
                .subgroup_stages(naga::valid::ShaderStages::COMPUTE)
                .subgroup_operations(naga::valid::SubgroupOperationSet::all());
            let checked = validator.validate(&module);
            if let Err(error) = checked {
                panic!("{}: {}", source.name, error.emit_to_string(&text));
            }
            assert_eq!(module.entry_points.len(), 1, "{}: one kernel a file", source.name);
        }
    }
}

#[test]
fn the_bindings_are_those_that_naga_sees() {
    for variant in VARIANTS {
        for source in sources() {
            let text = source.compose(variant);
            let module = module(&text, source.name);
            let mut seen: Vec<_> = module
                .global_variables
                .iter()
                .filter_map(|(_, variable)| {
                    let binding = variable.binding.as_ref()?;
                    assert_eq!(binding.group, 0);
                    let access = match variable.space {
                        naga::AddressSpace::Uniform => Access::Uniform,
                        naga::AddressSpace::Storage { access } if access.contains(naga::StorageAccess::STORE) => {
                            Access::ReadWrite
                        }
                        naga::AddressSpace::Storage { .. } => Access::Read,
                        space => panic!("{}: a binding in {space:?}", source.name),
                    };
                    Some((binding.binding, variable.name.clone()?, access))
                })
                .collect();
            let mut read: Vec<_> = bindings(&text).into_iter().map(|b| (b.number, b.name, b.access)).collect();
            seen.sort_by_key(|b| b.0);
            read.sort_by_key(|b| b.0);
            assert_eq!(read, seen, "{}", source.name);
            assert!(read.windows(2).all(|pair| pair[0].0 < pair[1].0), "{}: a number twice", source.name);
        }
    }
}

/// Compares the members of a block with the members of the struct `name` in a kernel.
fn same_layout(kernel: &str, name: &str, block: &Block) {
    let source = sources().find(|s| s.name == kernel).unwrap();
    let module = module(&source.compose(VARIANTS[0]), kernel);
    let (_, found) = module.types.iter().find(|(_, t)| t.name.as_deref() == Some(name)).unwrap();
    let naga::TypeInner::Struct { members, span } = &found.inner else { panic!("{name} is no struct") };
    let want: Vec<_> = members.iter().map(|m| (m.name.as_deref().unwrap(), m.offset as usize)).collect();
    assert_eq!(block.members, want, "{name}");
    assert_eq!(block.bytes().len(), *span as usize, "{name}");
}

#[test]
fn layouts_are_those_of_naga() {
    let geometry = Geometry::axis_aligned([9, 8, 7], DVec3::new(0.5, 0.75, 1.0));
    let levels = BinLevels::over(Vec3::ZERO, Vec3::splat(4.0), 1.0, 3);
    same_layout("move_particles", "Parameters", &run_block(&geometry, &levels, &crate::Parameters::default(), 504, 99));
    same_layout("move_particles", "Pass", &pass_block(3, 4, true));
    same_layout("begin_pass", "Planned", &plan_block(3, 4, true, 5, (6, 7)));
    same_layout("scan_blocks", "Scan", &scan_block(5));
    same_layout("scan_sums", "Scan", &scan_block(5));
    same_layout("scan_add", "Scan", &scan_block(5));
}

/// Returns the constants of a module by name, as evaluated by naga.
fn constants_of(module: &naga::Module) -> Vec<(String, Value)> {
    let value = |constant: &naga::Constant| match module.global_expressions[constant.init] {
        naga::Expression::Literal(naga::Literal::F32(value)) => Value::Real(value),
        naga::Expression::Literal(naga::Literal::U32(value)) => Value::Whole(value),
        ref other => panic!("{:?} is {other:?}", constant.name),
    };
    module.constants.iter().map(|(_, constant)| (constant.name.clone().unwrap(), value(constant))).collect()
}

#[test]
fn kernels_have_exactly_the_constants_of_rust() {
    for variant in VARIANTS {
        for source in sources() {
            let wanted = constants(source.variant(variant).team()).into_iter();
            let wanted: Vec<_> = wanted.map(|(name, value)| (name.to_owned(), value)).collect();
            let text = source.compose(variant);
            assert_eq!(constants_of(&module(&text, source.name)), wanted, "{}", source.name);
            let again = text + "const SKIN: f32 = 0.3;";
            assert!(naga::front::wgsl::parse_str(&again).is_err(), "{}: a second copy was taken", source.name);
        }
    }
}

#[test]
fn every_twin_that_a_shader_names_is_there() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let mut twins = 0;
    for folder in ["shaders", "shaders/shared", "shaders/tests"] {
        for entry in fs::read_dir(root.join(folder)).unwrap() {
            let shader = entry.unwrap().path();
            if shader.extension().is_none_or(|extension| extension != "wgsl") {
                continue;
            }
            let text = fs::read_to_string(&shader).unwrap();
            // format of a line: `name`, `name` in path/of/file.rs
            for line in text.lines().filter_map(|line| line.strip_prefix("// Twin: ")) {
                let (names, file) = line.rsplit_once(" in ").unwrap_or_else(|| panic!("{}: {line}", shader.display()));
                let rust =
                    fs::read_to_string(root.join(file)).unwrap_or_else(|e| panic!("{}: {file}: {e}", shader.display()));
                for name in names.split(", ").map(|name| name.trim_matches('`')) {
                    let defined = ["fn", "struct"].iter().any(|kind| {
                        let words = format!("{kind} {name}");
                        rust.match_indices(&words)
                            .any(|(at, _)| !rust[at + words.len()..].starts_with(is_part_of_a_name))
                    });
                    assert!(defined, "{}: {file} has no {name}", shader.display());
                    twins += 1;
                }
            }
        }
    }
    assert!(twins > 20, "{twins} twins were found");
}

fn is_part_of_a_name(c: char) -> bool {
    c.is_alphanumeric() || c == '_'
}
