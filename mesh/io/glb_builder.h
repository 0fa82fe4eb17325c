#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <nlohmann/json.hpp>
#include <ostream>
#include <string>
#include <vector>

namespace s2gs {

/// glTF's component types and buffer targets.
constexpr int kGlbUnsignedShort = 5123;
constexpr int kGlbUnsignedInt = 5125;
constexpr int kGlbFloat = 5126;
constexpr int kGlbArrayBuffer = 34962;
constexpr int kGlbElementArrayBuffer = 34963;
constexpr int kGlbNoTarget = 0;

/// glTF 2.0 in one binary file: one mesh in a node that turns z up into the format's y up. Parts of the
/// buffer are described first, in the order in which they are then written.
class GlbBuilder {
 public:
  GlbBuilder();

  /// The file's description; meshes, materials, textures and images are for the caller to add.
  nlohmann::json& json() { return json_; }

  /// Adds a part of the buffer, which begins at a multiple of 4, and returns the number of its view.
  /// \param write  writes exactly `bytes` bytes, later.
  size_t AddView(uint64_t bytes, int target, std::function<void(std::ostream&)> write);
  /// The same with an accessor, whose number it returns.
  size_t AddAccessor(uint64_t count, uint64_t bytes, int target, nlohmann::json accessor,
                     std::function<void(std::ostream&)> write);

  /// Throws UserError beyond the format's 4 GiB. \param path  for messages only.
  void Write(std::ostream& stream, const std::filesystem::path& path);

 private:
  struct Part {
    uint64_t bytes;
    std::function<void(std::ostream&)> write;
  };
  nlohmann::json json_;
  std::vector<Part> parts_;
  uint64_t num_bytes_ = 0;
};

/// Four bytes, the lowest first.
void WriteGlbWord(std::ostream& stream, uint64_t word);

}  // namespace s2gs
