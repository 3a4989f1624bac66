"""The keyword arguments of the functions. Made by ``make_options.py``; do not edit."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from os import PathLike
from typing import Literal, TypedDict

Labels = int | str | Iterable[int | str]
Materials = str | Iterable[str] | Mapping[str, Labels]
Pair = tuple[str, str]
# mypy does not accept a table of only texts as a table of texts or pairs
Sizes = str | Iterable[str] | Mapping[str, float] | Mapping[Pair, float] | Mapping[str | Pair, float]


class DistfieldOptions(TypedDict, total=False):
    """The options of :func:`isoparticles.distance_field`."""

    #: Series to read if a DICOM folder contains several, or part of a multi-frame file, given by
    #: its description, number or UID.
    series: str
    #: Region to keep: mm:x0..x1,y0..y1,z0..z1 is a box in world coordinates, and
    #: voxels:i0..i1,j0..j1,k0..k1 contains the numbers of the first and last voxel, from 0.
    crop: str | PathLike[str]
    #: Join each block of N x N x N voxels (N,M,K: of N x M x K) to one voxel, after ``--crop``: the
    #: mean for a scan (``--iso``), and the most frequent label for a label map (the smallest of
    #: several).
    downsample: int | str | Iterable[int]
    #: Iso value of the surface, in the unit of the voxel values, between their minimum and maximum.
    iso: float
    #: Side of the iso value on which the object lies. Default: above.
    inside: Literal["above", "below"]
    #: Labels whose union is the object, separated by commas or spaces: numbers, ranges such as 2..5
    #: (only labels that occur), all (every label except 0), or names from the file.
    labels: Labels
    #: Define a material by its labels, such as lung=2+3.
    material: Materials
    #: The same as material.
    materials: Materials
    #: With ``--material``: rule for the voxels of several materials, which segments and masks can
    #: share. Default: listed.
    overlap: Literal["listed", "smaller"]
    #: With ``--material``: reassign each connected component with fewer voxels than this, including
    #: components of the outside, to the material with which it shares the most voxel faces.
    #: Default: 1.
    smallest_island: int
    #: Kind of volume. Default: auto.
    kind: Literal["auto", "scan", "labels"]
    #: Treatment of the object at the border of the volume: cap closes the object half a voxel
    #: beyond the outermost voxel centres, with rims rounded by half a voxel. Default: cap.
    border: Literal["cap", "flat", "open"]
    #: Cut the object, or all materials, by a plane through X,Y,Z (mm, world frame of the output),
    #: and remove the side to which the normal NX,NY,NZ points.
    cut: str | Iterable[str]
    #: Extent of the grid: object is the bounding box of the object, enlarged by the voxels on which
    #: F depends near the surface. Default: object.
    grid: Literal["object", "volume"]
    #: Connected parts of the object to keep: all, only the largest, or those with a volume of at
    #: least VOLUME mm^3. Default: all.
    keep: float | str
    #: Number of additional voxels on each face of the grid, 3 to 64, as room for F around the
    #: surface. Default: 5.
    margin: int
    #: Labels without a scale: minimum distance between the surface and every voxel centre, in units
    #: of the minimum voxel spacing, 0.01 to 0.15. Default: 0.05.
    clearance: float
    #: World frame of the output, which later stages keep: lps (left, posterior, superior), ras
    #: (right, anterior, superior), or scanner, the frame of the input file: RAS for NIfTI,
    #: FreeSurfer and RAS NRRD, LPS for DICOM and MetaImage. Default: lps.
    space: Literal["lps", "ras", "scanner"]
    #: Smooth away details smaller than this length, mm. Default: 0.
    scale: float
    #: Choose the scale for a mesh with this edge length, mm: 1.6 times the edge length (for labels,
    #: at least 2.7 voxels) if the edge length exceeds 0.75 voxel, because voxel steps would be
    #: visible.
    scale_for_size: float
    #: Choose the scale for a mesh with this number of vertices.
    scale_for_vertices: int
    #: Choose the scale for the minimum h that ``sizefield --quality`` sets: ``coarse`` (1.5 voxels)
    #: gives a scale above 0.
    quality: Literal["coarse", "medium", "fine"]
    #: Several materials only: edge length of the mesh on all interfaces of a material, mm, as for
    #: ``sizefield --size``.
    size: Sizes
    #: Keep parts and gaps that are too thin for a mesh with the edge length of the scale.
    keep_thin: bool
    #: With a scale: accept objects and materials whose volume changes by more than 10 %.
    accept_losses: bool
    #: Number of CPU threads, 0 for all cores. Default: 0.
    threads: int
    #: Memory limit, such as 8G or 500M. Default: the free memory of the machine.
    max_memory: int | str
    #: Seed for random numbers, an integer of at least 0. Default: 1.
    seed: int


class SizefieldOptions(TypedDict, total=False):
    """The options of :func:`isoparticles.size_field`."""

    #: Set the defaults of the next five options. Default: medium.
    quality: Literal["coarse", "medium", "fine"]
    #: Ratio of edge length to local feature size, above 0 (the paper's epsilon). Default: 0.5;
    #: coarse 1, fine 0.25.
    epsilon: float
    #: Maximum change of h per mm of distance, above 0 (the paper's delta). Default: 0.4; fine 0.3.
    delta: float
    #: Minimum h, mm. Default: 0.75 times the mean voxel spacing; coarse 1.5, fine 0.5.
    min_size: float
    #: Maximum h at the surface, mm. Default: 0.1 times the diagonal of the object's bounding box;
    #: coarse 0.2, fine 0.05.
    max_size: float
    #: Limit h so that the centre of a triangle is at most this far from the curved surface, mm.
    #: Default: 0.1 times the mean voxel spacing; coarse 0.4, fine 0.04.
    max_deviation: float
    #: Multiply the h that results from the options above by this factor, above 0, before grading.
    #: Default: 1.
    scale: float
    #: Several materials only: set h (mm) on all interfaces of a material, or on the interface of
    #: two materials, instead of deriving it from the shape.
    size: Sizes
    #: Use this h everywhere, mm, instead of the options above.
    uniform: float
    #: Choose h so that the settled surface has about this number of vertices (to within 5 %), 4 or
    #: more.
    vertices: int
    #: Limit h to H (mm) within RADIUS of a point or in the nonzero voxels of a mask volume (on any
    #: grid), or to the values of the point array ``h`` at the points of a .vtp or .vtu file.
    refine: str | Iterable[str]
    #: Set h to H in a region, after all other options have determined h.
    resize: str | Iterable[str]
    #: Number of CPU threads, 0 for all cores. Default: 0.
    threads: int
    #: Memory limit, such as 8G or 500M. Default: the free memory of the machine.
    max_memory: int | str
    #: Seed for random numbers, an integer of at least 0. Default: 1.
    seed: int


class SeedOptions(TypedDict, total=False):
    """The options of :func:`isoparticles.seed`."""

    #: Source of the seeds (one object only). Default: poisson-disk.
    from_: Literal["poisson-disk", "marching-cubes"]
    #: Number of particles to seed, 4 or more, instead of the number that the size field requires.
    count: int
    #: Number of CPU threads, 0 for all cores. Default: 0.
    threads: int
    #: Memory limit, such as 8G or 500M. Default: the free memory of the machine.
    max_memory: int | str
    #: Seed for random numbers, an integer of at least 0. Default: 1.
    seed: int


class ParticlesOptions(TypedDict, total=False):
    """The options of :func:`isoparticles.settle`."""

    #: Device that moves the particles. Default: auto.
    backend: Literal["auto", "gpu", "cpu"]
    #: GPU to use, selected by a case-insensitive part of its name (see ``--list-adapters``).
    adapter: str
    #: Measure the time of each GPU kernel with timestamp queries and include it in the report and
    #: the closing table.
    profile: bool
    #: Use the method as printed in the paper: options that are not given have the values marked
    #: "printed" below.
    as_printed: bool
    #: Bins of the neighbour search on a GPU. Default: graded; printed: uniform.
    binning: Literal["graded", "uniform"]
    #: Order in which a GPU moves the particles of a pass. Default: classes; printed: bins.
    order: Literal["classes", "bins"]
    #: Maximum number of passes on the last level, whose edge length is h. Default: 150; printed:
    #: 50.
    max_passes: int
    #: Number of levels, 1 to 4: settle at 2^(N - 1) times h first, then split the edges and settle
    #: again, down to h. Default: 3 on the cpu, 1 on a gpu and for several materials; printed: 1.
    levels: int
    #: Maximum number of passes on each level except the last. Default: 100.
    coarse_passes: int
    #: Stop when the number of lattice defects (particles without exactly six neighbours) decreases
    #: by less than this fraction per pass and density control is nearly at rest, 0 to 1. Default:
    #: 0.0075; printed: none.
    defect_tolerance: float
    #: Use the paper's stop test (E_min) instead: stop when the mean energy changes by less than
    #: this fraction per pass, 0 to 1. Default: none; printed: 0.0015.
    energy_tolerance: float
    #: Number of passes over which the paper's stop test averages this change. Default: 5; printed:
    #: 1.
    energy_window: int
    #: Apply the stop tests only when density control adds and deletes at most this fraction of the
    #: particles per pass, 0 to 1. Default: 0.002; printed: 1.
    rest_share: float
    #: Number of passes without density control at the end, in which the last added particles
    #: settle. Default: 10; printed: 0.
    closing_passes: int
    #: Target energy of a particle for density control, 0.554 to 7.84. Default: 0.7108; printed:
    #: 3.462.
    ideal_energy: float
    #: Add a particle where the energy is below this fraction of the ideal energy, 0 to 1. Default:
    #: 0.8; printed: 0.75.
    add_below: float
    #: Delete a particle whose energy exceeds this multiple of the ideal energy, above 1. Default:
    #: 1.25; printed: 1.35.
    delete_above: float
    #: Never add particles, and use a single level (as in the paper's synthetic test, Table 3).
    no_insert: bool
    #: Number of CPU threads, 0 for all cores. Default: 0.
    threads: int
    #: Memory limit, such as 8G or 500M. Default: the free memory of the machine.
    max_memory: int | str
    #: Seed for random numbers, an integer of at least 0. Default: 1.
    seed: int


class ReconstructOptions(TypedDict, total=False):
    """The options of :func:`isoparticles.reconstruct`."""

    #: Method that connects the particles. Default: restricted.
    method: Literal["restricted", "tight-cocone"]
    #: Maximum distance of a triangle's centroid from F = 0, mm, above 0. Default: a quarter of h or
    #: of a voxel, whichever is larger.
    max_deviation: float
    #: Maximum number of rounds that add points, 0 to 100. Default: 40.
    max_rounds: int
    #: Improve triangles below this radius ratio by local moves, 0 to 1. Default: 0.9.
    improve_below: float
    #: Number of sweeps over the whole mesh before ``--improve-below`` applies, 0 to 20. Default: 3.
    relaxation_sweeps: int
    #: World frame of the mesh: lps (left, posterior, superior), ras (right, anterior, superior), or
    #: scanner, the frame of the file that distfield read. Default: that of the particles.
    space: Literal["lps", "ras", "scanner"]
    #: Minimum radius ratio of a triangle, 0 to 1. Default: 0.3 with a distance field; none without.
    min_radius_ratio: float
    #: Several materials: accept triangles below ``--min-radius-ratio`` where junction curves allow
    #: no better ones.
    accept_forced: bool
    #: Maximum distance of a vertex from F = 0, in voxels (geometric mean of the spacing), above 0.
    #: Default: 0.0001.
    max_vertex_distance: float
    #: Number of CPU threads, 0 for all cores. Default: 0.
    threads: int
    #: Memory limit, such as 8G or 500M. Default: the free memory of the machine.
    max_memory: int | str
    #: Seed for random numbers, an integer of at least 0. Default: 1.
    seed: int


class TetmeshOptions(TypedDict, total=False):
    """The options of :func:`isoparticles.fill`."""

    #: World frame of the meshes and of the places in the report: lps (left, posterior, superior),
    #: ras (right, anterior, superior), or scanner, the frame of the file that distfield read.
    space: Literal["lps", "ras", "scanner"]
    #: Name the triangles of the outer boundary with their centre in ball:X,Y,Z,RADIUS, or on the
    #: side of plane:X,Y,Z,NX,NY,NZ that its normal points to, in mm, in the frame of the output.
    tag: str | Iterable[str]
    #: Define a set, such as 'epi = wall/outside - caps' or 'inlet = lumen_cap_z0_1'.
    set: str | Iterable[str]
    #: Tetrahedralizer. Default: auto.
    method: Literal["auto", "ftetwild", "hxt", "tetgen"]
    #: Ratio of the edge length of the tetrahedra to h, 0.1 to 100. Default: 1.0.
    tet_size_factor: float
    #: Maximum distance by which ftetwild moves the surface, mm, above 0.
    envelope: float
    #: Ftetwild: optimize until the largest AMIPS energy is below E, at least 3 (all tetrahedra
    #: regular).
    stop_energy: float
    #: Ftetwild: maximum number of optimization passes. Default: 80.
    max_passes: int
    #: Time limit of the tetrahedralizer, including all attempts, s. Default: 3600.0.
    max_seconds: float
    #: Minimum dihedral angle, degrees, 0 to 70. Default: 5.0.
    min_dihedral: float
    #: Minimum scaled Jacobian, 0 to 1. Default: 0.05.
    min_scaled_jacobian: float
    #: Maximum difference between the volumes of the tetrahedra and of the surface, percent.
    #: Default: 1.0.
    max_volume_change: float
    #: Maximum distance between the boundary of the tetrahedra and the surface, in both directions,
    #: mm.
    max_distance: float
    #: Many materials: accept tetrahedra below a limit of shape where the triangles of the surface
    #: allow no better ones.
    accept_forced: bool
    #: Whether to solve the test problems. Default: auto.
    solve: Literal["auto", "yes", "no"]
    #: Time limit of the test problems, s. Default: 600.0.
    solve_seconds: float
    #: Material that contains the current source, and the current density in world coordinates,
    #: uA/mm^2.
    source: str
    #: Conductivity of a material, S/m, above 0.
    conductivity: Mapping[str, float] | str | Iterable[str]
    #: The material that gets fibres.
    fibres: str
    #: Endocardium of the left ventricle, or of the only one: an expression of ``--set``, such as
    #: wall/blood.
    endo: str
    #: Endocardium of the right ventricle.
    endo_rv: str
    #: Epicardium, such as 'wall/outside - caps'.
    epi: str
    #: Base, such as caps.
    base: str
    #: Ends of the outflow tracts, such as aortic + pulmonary: helix angles change to ``--helix-
    #: outflow`` there, and the apicobasal direction points towards ``--base`` and these ends.
    outflow: str
    #: Position, mm, in the frame of the output: the apex is the nearest point of the muscle that is
    #: not on the base or ``--outflow``.
    apex: str | Iterable[float]
    #: The same for the right ventricle.
    apex_rv: str | Iterable[float]
    #: Angles from the circumferential direction to the fibre at both surfaces, degrees, -90 to 90.
    helix: str | Iterable[float]
    #: The same angles in the right ventricle.
    helix_rv: str | Iterable[float]
    #: The same angles at ``--outflow``.
    helix_outflow: str | Iterable[float]
    #: The same angles at ``--outflow`` in the right ventricle.
    helix_outflow_rv: str | Iterable[float]
    #: Angles from the transmural direction to the sheet at both surfaces, degrees, -90 to 90.
    sheet: str | Iterable[float]
    #: Number of CPU threads, 0 for all cores.
    threads: int
    #: Maximum memory of the run, such as 8G or 500M.
    max_memory: int | str
    #: Recorded only. Default: 1.
    seed: int


class MeshSettings(TypedDict, total=False):
    """The settings of :func:`isoparticles.mesh`."""

    #: The series of a folder of DICOM files, by description, number or UID.
    series: str
    #: The region to keep: a box such as mm:0..50,..,10.
    crop: str | PathLike[str]
    #: The number of voxels to join along each axis: 2 or 2,2,1.
    downsample: int | str | Iterable[int]
    #: The iso value.
    iso: float
    #: The labels to mesh.
    labels: Labels
    #: The materials to mesh together: all, or lungs:2,heart:1,rest:3+4..6.
    materials: Materials
    #: The side of ISO on which the object lies.
    inside: Literal["above", "below"]
    #: The treatment of the object at the border of the volume.
    border: Literal["cap", "flat", "open"]
    #: The world frame of the results: lps, ras, or scanner, that of INPUT.
    space: Literal["lps", "ras", "scanner"]
    #: The size of the features to smooth away, mm.
    scale: float
    #: The ratio of edge length to local feature size.
    epsilon: float
    #: The maximum gradient of the edge length.
    delta: float
    #: A constant edge length, mm.
    size: float
    #: The minimum edge length, mm.
    min_size: float
    #: The maximum edge length, mm.
    max_size: float
    #: The number of vertices of the surface.
    vertices: int
    #: How fine the mesh is.
    quality: Literal["coarse", "medium", "fine"]
    #: Changes of the edge length in regions of the finished surface: ball:X,Y,Z,RADIUS=H or
    #: mask:FILE=H, in this order.
    resize: str
    #: The number of particles to seed.
    count: int
    #: The seed for random numbers.
    seed: int
    #: The device that moves the particles.
    backend: Literal["auto", "gpu", "cpu"]
    #: Whether to accept objects and materials whose volume a scale changes by more than 10 %.
    accept_losses: bool
    #: Whether to accept elements below a limit where the surface allows no better ones.
    accept_forced: bool
    #: The maximum memory of a stage, such as 8G.
    max_memory: int | str
    #: Further options of distfield.
    distfield_options: str
    #: Further options of sizefield.
    sizefield_options: str
    #: Further options of particles.
    particles_options: str
    #: Further options of reconstruct.
    reconstruct_options: str
    #: The number of CPU threads, 0 for all cores.
    threads: int
