// Meshes a label image with CGAL's Mesh_3, for materials_peers.py. Junctions can be protected.
//
//   mesh_3 LABELS.raw NX NY NZ SX SY SZ SIZE JUNCTIONS.txt OUT.txt
//
// LABELS.raw contains NX x NY x NZ bytes, x fastest; 0 is the outside. SIZE is the target edge
// length of triangles and tetrahedra. Each line of JUNCTIONS.txt is a polyline: the number of its
// points, then their coordinates. An empty file protects no junctions. OUT.txt contains the numbers
// of points and tetrahedra, the peak memory in kB, the points, and the tetrahedra with their labels.
#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>
#include <CGAL/Image_3.h>
#include <CGAL/ImageIO.h>
#include <CGAL/Labeled_mesh_domain_3.h>
#include <CGAL/Mesh_complex_3_in_triangulation_3.h>
#include <CGAL/Mesh_criteria_3.h>
#include <CGAL/Mesh_domain_with_polyline_features_3.h>
#include <CGAL/Mesh_triangulation_3.h>
#include <CGAL/make_mesh_3.h>

#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <iomanip>
#include <map>
#include <string>
#include <vector>

using Kernel = CGAL::Exact_predicates_inexact_constructions_kernel;
using Domain = CGAL::Mesh_domain_with_polyline_features_3<CGAL::Labeled_mesh_domain_3<Kernel>>;
using Triangulation = CGAL::Mesh_triangulation_3<Domain>::type;
using Complex =
    CGAL::Mesh_complex_3_in_triangulation_3<Triangulation, Domain::Corner_index, Domain::Curve_index>;
using Criteria = CGAL::Mesh_criteria_3<Triangulation>;

int main(int count, char **words) {
    if (count != 11) return 2;
    const unsigned nx = std::atoi(words[2]), ny = std::atoi(words[3]), nz = std::atoi(words[4]);
    const double size = std::atof(words[8]);
    _image *raw = _createImage(nx, ny, nz, 1, std::atof(words[5]), std::atof(words[6]), std::atof(words[7]), 1,
                               WK_FIXED, SGN_UNSIGNED);
    std::ifstream labels(words[1], std::ios::binary);
    labels.read(static_cast<char *>(raw->data), std::streamsize(nx) * ny * nz);
    if (!labels) return 2;
    CGAL::Image_3 image(raw);

    Domain domain = Domain::create_labeled_image_mesh_domain(image, CGAL::parameters::relative_error_bound = 1e-6);
    std::ifstream junctions(words[9]);
    std::vector<std::vector<Kernel::Point_3>> polylines;
    for (std::size_t points; junctions >> points;) {
        polylines.emplace_back();
        for (double x, y, z; points > 0 && junctions >> x >> y >> z; --points) polylines.back().emplace_back(x, y, z);
    }
    domain.add_features(polylines.begin(), polylines.end());

    namespace p = CGAL::parameters;
    Criteria criteria(p::edge_size = size, p::facet_angle = 30, p::facet_size = size, p::facet_distance = size / 10,
                      p::cell_radius_edge_ratio = 2, p::cell_size = size);
    Complex complex = CGAL::make_mesh_3<Complex>(domain, criteria);

    std::ofstream out(words[10]);
    out << std::setprecision(17);
    const Triangulation &tr = complex.triangulation();
    std::map<Triangulation::Vertex_handle, std::size_t> number;
    for (auto v : tr.finite_vertex_handles()) number.emplace(v, number.size());
    long peak = 0;
    std::ifstream status("/proc/self/status");
    for (std::string line; std::getline(status, line);) std::sscanf(line.c_str(), "VmHWM: %ld kB", &peak);
    out << number.size() << ' ' << complex.number_of_cells_in_complex() << ' ' << peak << '\n';
    for (auto v : tr.finite_vertex_handles()) out << tr.point(v).x() << ' ' << tr.point(v).y() << ' ' << tr.point(v).z() << '\n';
    for (auto c = complex.cells_in_complex_begin(); c != complex.cells_in_complex_end(); ++c) {
        for (int k = 0; k < 4; ++k) out << number[c->vertex(k)] << ' ';
        out << int(complex.subdomain_index(c)) << '\n';
    }
    return out ? 0 : 2;
}
