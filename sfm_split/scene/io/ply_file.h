#pragma once

#include <cstdint>
#include <filesystem>
#include <istream>
#include <optional>
#include <ostream>
#include <string>
#include <string_view>
#include <utility>
#include <variant>
#include <vector>

namespace s2gs {

/// Polygon file format (PLY 1.0, G. Turk 1994): a text header that declares elements (tables) and their
/// properties (columns), then the rows, as text or binary. Tables are kept here column by column, whatever
/// their names, so that a file can be read, changed in part and written again without loss.

enum class PlyFormat : uint8_t { kAscii, kBinaryLittleEndian, kBinaryBigEndian };

/// The order is that of PlyValues' alternatives.
enum class PlyType : uint8_t { kInt8, kUint8, kInt16, kUint16, kInt32, kUint32, kFloat32, kFloat64 };

/// The values of one property over all rows; the alternative held is the property's type.
using PlyValues =
    std::variant<std::vector<int8_t>, std::vector<uint8_t>, std::vector<int16_t>, std::vector<uint16_t>,
                 std::vector<int32_t>, std::vector<uint32_t>, std::vector<float>, std::vector<double>>;

struct PlyProperty {
  std::string name;  ///< without white space.
  PlyValues values;  ///< a scalar's values, one a row; a list's items, all rows after each other.

  std::optional<PlyType> list_size_type;  ///< set for a list only: the integer type of the item counts.
  std::vector<uint64_t> list_begins;  ///< lists only: row r owns items [list_begins[r], list_begins[r+1]).

  bool is_list() const { return list_size_type.has_value(); }
  PlyType type() const { return static_cast<PlyType>(values.index()); }
};

struct PlyElement {
  std::string name;
  uint64_t num_rows = 0;
  std::vector<PlyProperty> properties;  ///< names are distinct.

  /// nullptr when there is no such property.
  const PlyProperty* Find(std::string_view property_name) const;
  PlyProperty* Find(std::string_view property_name);

  /// Appends a scalar property. All properties of an element have `num_rows` rows.
  template <typename T>
  void AddColumn(std::string property_name, std::vector<T> values) {
    properties.push_back({std::move(property_name), std::move(values), std::nullopt, {}});
  }
};

struct PlyFile {
  PlyFormat format = PlyFormat::kBinaryLittleEndian;
  std::vector<std::string> comments;  ///< the text after "comment ", in order.
  std::vector<std::string> obj_info;  ///< the text after "obj_info ", in order.
  std::vector<PlyElement> elements;   ///< names are distinct.

  /// nullptr when there is no such element.
  const PlyElement* Find(std::string_view element_name) const;
  PlyElement* Find(std::string_view element_name);
};

/// Reads all three formats. Header lines may end in LF or CRLF; numbers do not depend on the locale. A text
/// row is one line, empty lines are skipped. Throws UserError with the path and the line (text) or byte
/// (binary) for anything that breaks the format: rows that are missing or left over, values that their type
/// cannot hold, duplicate names, a header over 1 MiB.
/// \param path  for the stream form: for messages only.
PlyFile ReadPly(const std::filesystem::path& path);
PlyFile ReadPly(std::istream& stream, const std::filesystem::path& path);

/// Writes in `file.format`. Floating-point text is the shortest that reads back as the same value.
/// The path form is atomic. Columns of unequal length are a broken invariant.
void WritePly(const std::filesystem::path& path, const PlyFile& file);
void WritePly(std::ostream& stream, const PlyFile& file);

/// The scalar property of that name. Throws UserError when the element has none, or a list.
/// \param path  the file that the element came from, for the message.
const PlyProperty& RequirePlyScalar(const PlyElement& element, std::string_view property_name,
                                    const std::filesystem::path& path);

/// Values as float, whatever their stored type. The rvalue form moves what is float already.
std::vector<float> PlyFloats(const PlyValues& values);
std::vector<float> PlyFloats(PlyValues&& values);

/// "uchar", "float", ...: the type's name in a header.
const char* PlyTypeName(PlyType type);

/// Accepts both families of names ("uchar" and "uint8").
std::optional<PlyType> PlyTypeFromName(std::string_view name);

/// An empty column of that type.
PlyValues EmptyPlyValues(PlyType type);

/// Bytes of one value in the binary formats.
size_t PlyTypeSize(PlyType type);

}  // namespace s2gs
