//! Checks the kind determined for each shared volume.

use isoparticles_survey::kind::judge;
use isoparticles_survey::survey::Survey;
use isoparticles_tests::skip::real_volume;

#[test]
fn every_shared_volume_is_judged_right() {
    // lungs_label_big is excluded because it has 165 million voxels
    for (name, kind) in [
        ("brain_parcellation", "labels"),
        ("frog_tissue_labels", "labels"),
        ("heart_ct", "scan"),
        ("heart_label", "labels"),
        ("mickey_labels", "labels"),
        ("thorax_ct", "scan"),
        ("thorax_ct_native_u8", "scan"),
        ("thorax_labels", "labels"),
        ("tooth_ct", "scan"),
        ("trabecular_bone", "scan"),
    ] {
        let Some(path) = real_volume(&format!("{name}.nrrd")) else { continue };
        let volume = isoparticles_volume::read_volume(&path).expect("a volume");
        let judged = judge(&Survey::of(&volume.voxels, &volume.geometry), volume.segments.len());
        assert!(judged.certain && judged.kind.to_string() == kind, "{name}: {judged:?}");
    }
}
