//! Tests the user-facing errors for files that are not volumes. Each error names a stage or an
//! option that accepts the file, or the file to use instead.

use isoparticles_stage::error::Error;
use isoparticles_volume::read_volume;
use std::path::Path;

#[test]
fn what_is_no_volume_names_the_stage_that_takes_it() {
    let folder = tempfile::tempdir().expect("folder");
    let write = |name: &str, bytes: &[u8]| {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).expect("written");
        path
    };
    let golden = |name: &str| Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/golden").join(name);
    for (path, stage) in [
        (golden("surface_v2.vtp"), "tetmesh-check"),
        (golden("surface_v1.ply"), "tight-cocone"),
        (golden("surface_v1.stl"), "tetmesh-check"),
        (golden("surface_v1.obj"), "tetmesh-check"),
        (golden("particles_v1.checkpoint.bin"), "particles --resume"),
        (write("seeds", b"ISOPART\n\x01\0\0\0"), "particles"),
        (write("settled", b"ISOPART\n\x02\0\0\0"), "reconstruct"),
        (write("mesh", b"<VTKFile type=\"UnstructuredGrid\">"), "volume that it was made from"),
        (write("old.vtk", b"# vtk DataFile Version 3.0"), ".vti"),
        (write("slice", &[&[0; 128][..], b"DICM"].concat()), "folder"),
        (write("text.txt", b"hello"), "convert"),
    ] {
        let error = Error::from(read_volume(&path).expect_err("no volume"));
        assert!(error.next.contains(stage), "{stage} is not in: {error}");
    }
}
