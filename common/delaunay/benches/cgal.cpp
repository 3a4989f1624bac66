// Times the Delaunay triangulation of a file of points by CGAL. `compare.sh` runs this program and
// `ours.rs` on the same points. It is not part of the build. On Debian or Ubuntu:
//
//   apt-get install g++ libcgal-dev libtbb-dev
//   g++ -std=c++17 -O3 -DNDEBUG -frounding-math cgal.cpp -o cgal -ltbb -ltbbmalloc -lgmp -lmpfr
//
//   cgal FILE serial           one thread
//   cgal FILE parallel N       CGAL's parallel insertion on N threads
//
// FILE contains little-endian doubles, three per point. Prints one line of `key=value` pairs:
// points, vertices, finite cells, wall-clock seconds of the triangulation (file reading excluded),
// processor seconds summed over all threads, and the growth of the peak memory in bytes.

#define CGAL_LINKED_WITH_TBB

#include <CGAL/Delaunay_triangulation_3.h>
#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>
#include <CGAL/version.h>
#include <tbb/global_control.h>

#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <fstream>
#include <string>
#include <vector>

namespace {

using Kernel = CGAL::Exact_predicates_inexact_constructions_kernel;
using Point = Kernel::Point_3;
using Vertex = CGAL::Triangulation_vertex_base_3<Kernel>;
using Cell = CGAL::Delaunay_triangulation_cell_base_3<Kernel>;
using SerialStructure = CGAL::Triangulation_data_structure_3<Vertex, Cell, CGAL::Sequential_tag>;
using ParallelStructure = CGAL::Triangulation_data_structure_3<Vertex, Cell, CGAL::Parallel_tag>;
using Serial = CGAL::Delaunay_triangulation_3<Kernel, SerialStructure>;
using Parallel = CGAL::Delaunay_triangulation_3<Kernel, ParallelStructure>;

// Number of cells of CGAL's lock grid along each axis, as in CGAL's examples.
constexpr int lock_grid = 50;

// Returns the value of a line of /proc/self/status, converted from KiB to bytes, or 0 if the line
// is missing.
long long memory(const char* key) {
    std::ifstream status("/proc/self/status");
    for (std::string line; std::getline(status, line);) {
        if (line.rfind(key, 0) == 0) return 1024 * std::atoll(line.c_str() + std::strlen(key) + 1);
    }
    return 0;
}

std::vector<Point> read(const char* path) {
    std::ifstream file(path, std::ios::binary);
    std::vector<Point> points;
    for (double xyz[3]; file.read(reinterpret_cast<char*>(xyz), sizeof xyz);) points.emplace_back(xyz[0], xyz[1], xyz[2]);
    points.shrink_to_fit();
    return points;
}

template <class Make>
int timed(const std::vector<Point>& points, Make make) {
    const long long before = memory("VmRSS");
    const std::clock_t clock = std::clock();
    const auto start = std::chrono::steady_clock::now();
    const auto triangulation = make();
    const std::chrono::duration<double> taken = std::chrono::steady_clock::now() - start;
    const double cpu = static_cast<double>(std::clock() - clock) / CLOCKS_PER_SEC;
    std::printf("program=CGAL-%s points=%zu vertices=%zu cells=%zu seconds=%.6f cpu=%.6f bytes=%lld\n", CGAL_VERSION_STR, points.size(),
                triangulation.number_of_vertices(), triangulation.number_of_finite_cells(), taken.count(), cpu,
                memory("VmHWM") - before);
    return 0;
}

}  // namespace

int main(int argc, char** argv) {
    const std::string mode = argc > 2 ? argv[2] : "";
    const int threads = argc > 3 ? std::atoi(argv[3]) : 0;
    if (!(mode == "serial" && argc == 3) && !(mode == "parallel" && threads > 0)) {
        std::fprintf(stderr, "usage: cgal FILE serial | cgal FILE parallel THREADS\n");
        return 2;
    }
    const std::vector<Point> points = read(argv[1]);
    if (points.empty()) {
        std::fprintf(stderr, "%s: no points could be read\n", argv[1]);
        return 2;
    }
    if (mode == "serial") {
        return timed(points, [&] { return Serial(points.begin(), points.end()); });
    }
    const tbb::global_control control(tbb::global_control::max_allowed_parallelism, threads);
    Parallel::Lock_data_structure locks(CGAL::bbox_3(points.begin(), points.end()), lock_grid);
    // the locks must outlive the triangulation; creating them is not timed
    return timed(points, [&] { return Parallel(points.begin(), points.end(), &locks); });
}
