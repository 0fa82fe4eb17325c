#include "mesh/io/glb_builder.h"

#include <array>
#include <limits>
#include <utility>

#include "sfm_split/base/error.h"

namespace s2gs {

GlbBuilder::GlbBuilder() {
  json_["asset"] = {{"version", "2.0"}, {"generator", "s2gs"}};
  json_["scene"] = 0;
  json_["scenes"][0]["nodes"][0] = 0;
  json_["nodes"][0]["mesh"] = 0;
  // A quarter turn about x: (x, y, z) to (x, z, -y).
  json_["nodes"][0]["rotation"] = {-0.70710678118654752, 0, 0, 0.70710678118654752};
  json_["bufferViews"] = nlohmann::json::array();
  json_["accessors"] = nlohmann::json::array();
}

size_t GlbBuilder::AddView(uint64_t bytes, int target, std::function<void(std::ostream&)> write) {
  nlohmann::json view = {{"buffer", 0}, {"byteOffset", num_bytes_}, {"byteLength", bytes}};
  if (target != kGlbNoTarget) view["target"] = target;
  json_["bufferViews"].push_back(std::move(view));
  parts_.push_back({bytes, std::move(write)});
  num_bytes_ += (bytes + 3) / 4 * 4;
  return json_["bufferViews"].size() - 1;
}

size_t GlbBuilder::AddAccessor(uint64_t count, uint64_t bytes, int target, nlohmann::json accessor,
                               std::function<void(std::ostream&)> write) {
  accessor["bufferView"] = AddView(bytes, target, std::move(write));
  accessor["count"] = count;
  json_["accessors"].push_back(std::move(accessor));
  return json_["accessors"].size() - 1;
}

void GlbBuilder::Write(std::ostream& stream, const std::filesystem::path& path) {
  json_["buffers"][0]["byteLength"] = num_bytes_;
  std::string text = json_.dump();
  text.resize((text.size() + 3) / 4 * 4, ' ');
  const uint64_t length = 12 + 8 + text.size() + 8 + num_bytes_;
  if (length > std::numeric_limits<uint32_t>::max()) {
    throw UserError(path, "the mesh is too large for this format",
                    "Write .ply, or set a lower max_triangles");
  }
  WriteGlbWord(stream, 0x46546C67);  // "glTF"
  WriteGlbWord(stream, 2);
  WriteGlbWord(stream, length);
  WriteGlbWord(stream, text.size());
  WriteGlbWord(stream, 0x4E4F534A);  // "JSON"
  stream << text;
  WriteGlbWord(stream, num_bytes_);
  WriteGlbWord(stream, 0x004E4942);  // "BIN"
  for (const Part& part : parts_) {
    part.write(stream);
    for (uint64_t i = part.bytes; i % 4 != 0; ++i) stream.put('\0');
  }
}

void WriteGlbWord(std::ostream& stream, uint64_t word) {
  std::array<char, 4> bytes{};
  for (size_t i = 0; i < bytes.size(); ++i) bytes[i] = static_cast<char>(word >> (8 * i) & 255U);
  stream.write(bytes.data(), bytes.size());
}

}  // namespace s2gs
