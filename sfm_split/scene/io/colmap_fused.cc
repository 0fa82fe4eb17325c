#include "sfm_split/scene/io/colmap_fused.h"

#include <array>
#include <limits>
#include <string>
#include <utility>

#include "sfm_split/base/byte_reader.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/scene/io/ply_file.h"

namespace s2gs {
namespace {

constexpr char kRemedy[] = "Run `colmap stereo_fusion` first";           // of every fault
constexpr std::array<const char*, 3> kPosition = {"x", "y", "z"};        // names of the file's properties
constexpr std::array<const char*, 3> kNormal = {"nx", "ny", "nz"};       // likewise
constexpr std::array<const char*, 3> kColor = {"red", "green", "blue"};  // likewise

std::filesystem::path VisibilityPath(std::filesystem::path path) { return path += ".vis"; }

std::vector<Eigen::Vector3f> TakeVectors(PlyElement& element, const std::array<const char*, 3>& names,
                                         const std::filesystem::path& path) {
  std::vector<Eigen::Vector3f> vectors(element.num_rows);
  for (int i = 0; i < 3; ++i) {
    RequirePlyScalar(element, names[i], path);
    const std::vector<float> column = PlyFloats(std::move(element.Find(names[i])->values));
    for (size_t row = 0; row < vectors.size(); ++row) vectors[row][i] = column[row];
  }
  return vectors;
}

template <typename Vector>
void AddVectors(const std::vector<Vector>& vectors, const std::array<const char*, 3>& names,
                PlyElement& element) {
  for (int i = 0; i < 3; ++i) {
    std::vector<typename Vector::Scalar> column(vectors.size());
    for (size_t row = 0; row < vectors.size(); ++row) column[row] = vectors[row][i];
    element.AddColumn(names[i], std::move(column));
  }
}

}  // namespace

ColmapVisibility ReadColmapVisibility(std::istream& stream, const std::filesystem::path& path) {
  ByteReader reader(stream, path);
  ColmapVisibility visibility;
  const uint64_t num_points = reader.ReadCount(sizeof(uint32_t), "the number of points");
  visibility.begins.reserve(num_points + 1);
  for (uint64_t point = 0; point < num_points; ++point) {
    const auto num_images = reader.Read<uint32_t>("a point's number of images");
    reader.CheckCount(num_images, sizeof(uint32_t), "a point's number of images");
    const size_t begin = visibility.image_indices.size();
    visibility.image_indices.resize(begin + num_images);
    reader.ReadBytes(visibility.image_indices.data() + begin, num_images * sizeof(uint32_t),
                     "a point's images");
    visibility.begins.push_back(visibility.image_indices.size());
  }
  reader.ExpectEnd();
  return visibility;
}

ColmapFusedCloud ReadColmapFusedCloud(const std::filesystem::path& path) {
  ColmapFusedCloud cloud;
  {
    std::ifstream stream = OpenForReading(path, kRemedy);
    PlyFile file = ReadPly(stream, path);
    PlyElement* vertices = file.Find("vertex");
    if (vertices == nullptr) throw UserError(path, "has no element 'vertex'", kRemedy);
    cloud.points = TakeVectors(*vertices, kPosition, path);
    cloud.normals = TakeVectors(*vertices, kNormal, path);
    cloud.colors.resize(vertices->num_rows);
    for (int i = 0; i < 3; ++i) {
      const auto* column =
          std::get_if<std::vector<uint8_t>>(&RequirePlyScalar(*vertices, kColor[i], path).values);
      if (column == nullptr) {
        throw UserError(path, std::string("its property '") + kColor[i] + "' is not of type uchar", kRemedy);
      }
      for (size_t row = 0; row < column->size(); ++row) cloud.colors[row][i] = (*column)[row];
    }
  }
  for (size_t row = 0; row < cloud.points.size(); ++row) {
    if (!cloud.points[row].allFinite()) {
      throw UserError(path, "point " + std::to_string(row) + " is not finite", kRemedy);
    }
  }
  const std::filesystem::path visibility_path = VisibilityPath(path);
  std::ifstream stream = OpenForReading(visibility_path, kRemedy);
  cloud.visibility = ReadColmapVisibility(stream, visibility_path);
  if (cloud.visibility.begins.size() != cloud.points.size() + 1) {
    throw UserError(visibility_path,
                    "has " + std::to_string(cloud.visibility.begins.size() - 1) + " points, but " +
                        path.filename().string() + " has " + std::to_string(cloud.points.size()),
                    "The two files are of different runs. " + std::string(kRemedy));
  }
  return cloud;
}

void WriteColmapVisibility(std::ostream& stream, const ColmapVisibility& visibility) {
  const std::vector<uint64_t>& begins = visibility.begins;
  S2GS_INVARIANT(!begins.empty() && begins.front() == 0 && begins.back() == visibility.image_indices.size());
  const auto write = [&stream](const auto* values, uint64_t count) {
    stream.write(reinterpret_cast<const char*>(values),
                 static_cast<std::streamsize>(count * sizeof(*values)));
  };
  const uint64_t num_points = begins.size() - 1;
  write(&num_points, 1);
  for (uint64_t point = 0; point < num_points; ++point) {
    S2GS_INVARIANT(begins[point] <= begins[point + 1]);
    const uint64_t count = begins[point + 1] - begins[point];
    S2GS_INVARIANT(count <= std::numeric_limits<uint32_t>::max());
    const auto num_images = static_cast<uint32_t>(count);
    write(&num_images, 1);
    write(visibility.image_indices.data() + begins[point], count);
  }
}

void WriteColmapFusedCloud(const std::filesystem::path& path, const ColmapFusedCloud& cloud) {
  S2GS_INVARIANT(cloud.normals.size() == cloud.points.size());
  S2GS_INVARIANT(cloud.colors.size() == cloud.points.size());
  S2GS_INVARIANT(cloud.visibility.begins.size() == cloud.points.size() + 1);
  PlyFile file;
  PlyElement vertices;
  vertices.name = "vertex";
  vertices.num_rows = cloud.points.size();
  AddVectors(cloud.points, kPosition, vertices);
  AddVectors(cloud.normals, kNormal, vertices);
  AddVectors(cloud.colors, kColor, vertices);
  file.elements.push_back(std::move(vertices));
  WriteFileAtomically(VisibilityPath(path),
                      [&](std::ostream& stream) { WriteColmapVisibility(stream, cloud.visibility); });
  WriteFileAtomically(path, [&](std::ostream& stream) { WritePly(stream, file); });
}

}  // namespace s2gs
