#include "sfm_split/scene/io/ply_file.h"

#include <algorithm>
#include <array>

#include "sfm_split/base/error.h"

namespace s2gs {
namespace {

struct TypeRow {
  const char* name;
  const char* sized_name;
  size_t size;
};

// In the order of PlyValues: both names that files use, bytes.
constexpr std::array<TypeRow, std::variant_size_v<PlyValues>> kTypes = {{{"char", "int8", 1},
                                                                         {"uchar", "uint8", 1},
                                                                         {"short", "int16", 2},
                                                                         {"ushort", "uint16", 2},
                                                                         {"int", "int32", 4},
                                                                         {"uint", "uint32", 4},
                                                                         {"float", "float32", 4},
                                                                         {"double", "float64", 8}}};

template <typename Items>
auto* FindByName(Items& items, std::string_view name) {
  const auto found =
      std::find_if(items.begin(), items.end(), [&](const auto& item) { return item.name == name; });
  return found == items.end() ? nullptr : &*found;
}

template <typename T>
std::vector<T> Converted(const PlyValues& values) {
  return std::visit([](const auto& v) { return std::vector<T>(v.begin(), v.end()); }, values);
}

}  // namespace

const char* PlyTypeName(PlyType type) { return kTypes[static_cast<size_t>(type)].name; }

size_t PlyTypeSize(PlyType type) { return kTypes[static_cast<size_t>(type)].size; }

std::optional<PlyType> PlyTypeFromName(std::string_view name) {
  for (size_t i = 0; i < kTypes.size(); ++i) {
    if (name == kTypes[i].name || name == kTypes[i].sized_name) return static_cast<PlyType>(i);
  }
  return std::nullopt;
}

PlyValues EmptyPlyValues(PlyType type) {
  switch (type) {
    case PlyType::kInt8:
      return std::vector<int8_t>();
    case PlyType::kUint8:
      return std::vector<uint8_t>();
    case PlyType::kInt16:
      return std::vector<int16_t>();
    case PlyType::kUint16:
      return std::vector<uint16_t>();
    case PlyType::kInt32:
      return std::vector<int32_t>();
    case PlyType::kUint32:
      return std::vector<uint32_t>();
    case PlyType::kFloat32:
      return std::vector<float>();
    case PlyType::kFloat64:
      break;
  }
  return std::vector<double>();
}

const PlyProperty* PlyElement::Find(std::string_view property_name) const {
  return FindByName(properties, property_name);
}
PlyProperty* PlyElement::Find(std::string_view property_name) {
  return FindByName(properties, property_name);
}
const PlyElement* PlyFile::Find(std::string_view element_name) const {
  return FindByName(elements, element_name);
}
PlyElement* PlyFile::Find(std::string_view element_name) { return FindByName(elements, element_name); }

const PlyProperty& RequirePlyScalar(const PlyElement& element, std::string_view property_name,
                                    const std::filesystem::path& path) {
  const PlyProperty* property = element.Find(property_name);
  if (property == nullptr || property->is_list()) {
    throw UserError(
        path,
        "its element '" + element.name + "' has no scalar property '" + std::string(property_name) + "'",
        "The file is of another kind, or was written by an incompatible program");
  }
  return *property;
}

std::vector<float> PlyFloats(const PlyValues& values) { return Converted<float>(values); }

std::vector<float> PlyFloats(PlyValues&& values) {
  if (auto* floats = std::get_if<std::vector<float>>(&values)) return std::move(*floats);
  return Converted<float>(values);
}

}  // namespace s2gs
