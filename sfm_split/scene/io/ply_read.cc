#include <algorithm>
#include <charconv>
#include <cstring>
#include <limits>
#include <unordered_set>

#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/scene/io/ply_file.h"
#include "sfm_split/scene/io/ply_source.h"

namespace s2gs {
namespace {

constexpr uint64_t kMaxHeaderBytes = uint64_t{1} << 20;              // some thousand properties
constexpr uint64_t kNoLimit = std::numeric_limits<uint64_t>::max();  // of a line: the file's size bounds it

bool IsBlank(char c) { return c == ' ' || c == '\t' || c == '\r' || c == '\v' || c == '\f'; }

// Takes the next word off the line's front; empty at the line's end.
std::string_view NextWord(std::string_view& line) {
  size_t begin = 0;
  while (begin < line.size() && IsBlank(line[begin])) ++begin;
  size_t end = begin;
  while (end < line.size() && !IsBlank(line[end])) ++end;
  const std::string_view word = line.substr(begin, end - begin);
  line.remove_prefix(end);
  return word;
}

// Text from the file, fit for a message.
std::string Quoted(std::string_view text) {
  constexpr size_t kMaxShown = 60;  // characters of a message
  std::string quoted = "'";
  for (const char c : text.substr(0, kMaxShown)) quoted += c >= ' ' && c <= '~' ? c : '?';
  return quoted + (text.size() > kMaxShown ? "...'" : "'");
}

std::string CellName(const PlyElement& element, uint64_t row, const PlyProperty& property) {
  return "property '" + property.name + "' of element '" + element.name + "', row " + std::to_string(row);
}

// --- Header ------------------------------------------------------------------------------------------------

class HeaderReader {
 public:
  explicit HeaderReader(PlySource& source) : source_(source) {}

  PlyFile Read() {
    if (TakeHeaderLine() != "ply") source_.FailAtLine("a PLY file begins with the line 'ply'");
    while (true) {
      const std::string_view line = TakeHeaderLine();
      std::string_view rest = line;
      const std::string_view keyword = NextWord(rest);
      if (keyword == "end_header") break;
      if (keyword == "comment") {
        file_.comments.emplace_back(Text(rest));
      } else if (keyword == "obj_info") {
        file_.obj_info.emplace_back(Text(rest));
      } else if (keyword == "format") {
        ReadFormat(rest);
      } else if (keyword == "element") {
        ReadElement(rest);
      } else if (keyword == "property") {
        ReadProperty(rest);
      } else {
        source_.FailAtLine(Quoted(line) + " is no line of a PLY header");
      }
    }
    if (!has_format_) source_.FailAtLine("the header has no 'format' line");
    for (const PlyElement& element : file_.elements) {
      if (element.properties.empty() && element.num_rows > 0) {
        source_.FailAtLine("element '" + element.name + "' has rows, but no properties");
      }
    }
    return std::move(file_);
  }

 private:
  std::string_view TakeHeaderLine() {
    if (source_.offset() > kMaxHeaderBytes) {
      source_.FailAtLine("the header is longer than " + std::to_string(kMaxHeaderBytes) + " bytes");
    }
    if (source_.remaining() == 0) source_.FailAtLine("the file ends inside its header");
    return source_.TakeLine(kMaxHeaderBytes);
  }

  static std::string_view Text(std::string_view rest) {
    if (!rest.empty()) rest.remove_prefix(1);
    return rest;
  }

  void ExpectLineEnd(std::string_view rest) const {
    const std::string_view word = NextWord(rest);
    if (!word.empty()) source_.FailAtLine("unexpected " + Quoted(word));
  }

  void ReadFormat(std::string_view rest) {
    const std::string_view name = NextWord(rest);
    const std::string_view version = NextWord(rest);
    ExpectLineEnd(rest);
    if (has_format_) source_.FailAtLine("a second 'format' line");
    has_format_ = true;
    if (name == "ascii") {
      file_.format = PlyFormat::kAscii;
    } else if (name == "binary_little_endian") {
      file_.format = PlyFormat::kBinaryLittleEndian;
    } else if (name == "binary_big_endian") {
      file_.format = PlyFormat::kBinaryBigEndian;
    } else {
      source_.FailAtLine("unknown format " + Quoted(name));
    }
    if (version != "1.0") source_.FailAtLine("version " + Quoted(version) + " is not 1.0");
  }

  void ReadElement(std::string_view rest) {
    const std::string_view name = NextWord(rest);
    const std::string_view count = NextWord(rest);
    ExpectLineEnd(rest);
    PlyElement element;
    element.name = name;
    const auto parsed = std::from_chars(count.data(), count.data() + count.size(), element.num_rows);
    if (count.empty() || parsed.ec != std::errc() || parsed.ptr != count.data() + count.size()) {
      source_.FailAtLine(Quoted(count) + " is no number of rows");
    }
    if (!element_names_.insert(element.name).second) {
      source_.FailAtLine("a second element " + Quoted(name));
    }
    property_names_.clear();
    file_.elements.push_back(std::move(element));
  }

  PlyType ReadType(std::string_view& rest) const {
    const std::string_view name = NextWord(rest);
    const std::optional<PlyType> type = PlyTypeFromName(name);
    if (!type) source_.FailAtLine("unknown type " + Quoted(name));
    return *type;
  }

  void ReadProperty(std::string_view rest) {
    if (file_.elements.empty()) source_.FailAtLine("a property before the first element");
    PlyProperty property;
    std::string_view after = rest;
    if (NextWord(after) == "list") {
      rest = after;
      property.list_size_type = ReadType(rest);
      if (*property.list_size_type >= PlyType::kFloat32) {
        source_.FailAtLine("a list's size must have an integer type");
      }
      property.list_begins.push_back(0);
    }
    property.values = EmptyPlyValues(ReadType(rest));
    property.name = NextWord(rest);
    ExpectLineEnd(rest);
    if (property.name.empty()) source_.FailAtLine("the property has no name");
    if (!property_names_.insert(property.name).second) {
      source_.FailAtLine("a second property " + Quoted(property.name));
    }
    file_.elements.back().properties.push_back(std::move(property));
  }

  PlySource& source_;
  PlyFile file_;
  bool has_format_ = false;
  std::unordered_set<std::string> element_names_;
  std::unordered_set<std::string> property_names_;  // of the last element
};

// --- Text rows ---------------------------------------------------------------------------------------------

// False when the word is no number or the type cannot hold it.
template <typename T>
bool ParseNumber(std::string_view word, T& value) {
  if (!word.empty() && word.front() == '+') word.remove_prefix(1);
  const char* end = word.data() + word.size();
  auto parsed = std::from_chars(word.data(), end, value);
  if (parsed.ec == std::errc() && parsed.ptr == end) return true;
  // What is left: an integer written as "255.0", or a float below the smallest normal one.
  double wide = 0;
  parsed = std::from_chars(word.data(), end, wide);
  if (parsed.ec != std::errc() || parsed.ptr != end) return false;
  if (!(wide >= static_cast<double>(std::numeric_limits<T>::lowest())) ||
      !(wide <= static_cast<double>(std::numeric_limits<T>::max()))) {
    return false;
  }
  value = static_cast<T>(wide);
  return std::is_floating_point_v<T> || static_cast<double>(value) == wide;
}

class TextRows {
 public:
  TextRows(PlySource& source, PlyElement& element) : source_(source), element_(element) {}

  void Read() {
    if (element_.num_rows == 0) return;
    // A value takes a character and a separator, but for the file's last one.
    const uint64_t values_left = (source_.remaining() + 1) / 2;
    if (element_.num_rows > values_left / element_.properties.size()) {
      source_.FailAtLine("element '" + element_.name + "' has " + std::to_string(element_.num_rows) +
                         " rows by the header, more than the rest of the file can hold");
    }
    for (PlyProperty& property : element_.properties) {
      if (property.is_list()) {
        property.list_begins.reserve(element_.num_rows + 1);
      } else {
        std::visit([&](auto& values) { values.reserve(element_.num_rows); }, property.values);
      }
    }
    for (uint64_t row = 0; row < element_.num_rows; ++row) ReadRow(row);
  }

 private:
  void ReadRow(uint64_t row) {
    line_ = {};
    do {
      if (source_.remaining() == 0) {
        source_.FailAtLine("the file ends before row " + std::to_string(row) + " of element '" +
                           element_.name + "'");
      }
      line_ = source_.TakeLine(kNoLimit);
    } while (std::all_of(line_.begin(), line_.end(), IsBlank));

    for (PlyProperty& property : element_.properties) {
      uint64_t count = 1;
      if (property.is_list()) count = ReadListSize(row, property);
      std::visit(
          [&](auto& values) {
            for (uint64_t i = 0; i < count; ++i) {
              values.push_back(ReadValue<typename std::decay_t<decltype(values)>::value_type>(row, property));
            }
            if (property.is_list()) property.list_begins.push_back(values.size());
          },
          property.values);
    }
    const std::string_view extra = NextWord(line_);
    if (!extra.empty()) {
      source_.FailAtLine("row " + std::to_string(row) + " of element '" + element_.name +
                         "' has more values than properties: " + Quoted(extra));
    }
  }

  template <typename T>
  T ReadValue(uint64_t row, const PlyProperty& property) {
    T value{};
    const std::string_view word = NextWord(line_);
    if (word.empty()) source_.FailAtLine("the line ends before " + CellName(element_, row, property));
    if (!ParseNumber(word, value)) {
      source_.FailAtLine(Quoted(word) + " is no " + PlyTypeName(property.type()) + ", in " +
                         CellName(element_, row, property));
    }
    return value;
  }

  uint64_t ReadListSize(uint64_t row, const PlyProperty& property) {
    const std::string_view word = NextWord(line_);
    uint32_t size = 0;
    if (!ParseNumber(word, size) || size > (line_.size() + 1) / 2) {
      source_.FailAtLine(Quoted(word) + " is not the number of items that follow, in " +
                         CellName(element_, row, property));
    }
    return size;
  }

  PlySource& source_;
  PlyElement& element_;
  std::string_view line_;
};

// --- Binary rows -------------------------------------------------------------------------------------------

template <typename T, bool kSwap>
T LoadValue(const char* bytes) {
  T value;
  if constexpr (kSwap && sizeof(T) > 1) {
    char swapped[sizeof(T)];
    std::reverse_copy(bytes, bytes + sizeof(T), swapped);
    std::memcpy(&value, swapped, sizeof(T));
  } else {
    std::memcpy(&value, bytes, sizeof(T));
  }
  return value;
}

// One column out of rows that are `stride` bytes apart.
template <bool kSwap, typename T>
void LoadColumn(const char* bytes, size_t stride, uint64_t count, T* values) {
  for (uint64_t i = 0; i < count; ++i) values[i] = LoadValue<T, kSwap>(bytes + i * stride);
}

template <bool kSwap>
int64_t LoadInteger(PlyType type, const char* bytes) {
  switch (type) {
    case PlyType::kInt8:
      return LoadValue<int8_t, kSwap>(bytes);
    case PlyType::kUint8:
      return LoadValue<uint8_t, kSwap>(bytes);
    case PlyType::kInt16:
      return LoadValue<int16_t, kSwap>(bytes);
    case PlyType::kUint16:
      return LoadValue<uint16_t, kSwap>(bytes);
    case PlyType::kInt32:
      return LoadValue<int32_t, kSwap>(bytes);
    default:
      return LoadValue<uint32_t, kSwap>(bytes);
  }
}

template <bool kSwap>
class BinaryRows {
 public:
  BinaryRows(PlySource& source, PlyElement& element) : source_(source), element_(element) {}

  void Read() {
    if (element_.num_rows == 0) return;
    uint64_t min_row_bytes = 0;
    bool has_list = false;
    for (const PlyProperty& property : element_.properties) {
      has_list |= property.is_list();
      min_row_bytes += PlyTypeSize(property.list_size_type.value_or(property.type()));
    }
    S2GS_INVARIANT(min_row_bytes > 0);  // the header's check
    if (element_.num_rows > source_.remaining() / min_row_bytes) {
      source_.FailAtByte("element '" + element_.name + "' has " + std::to_string(element_.num_rows) +
                         " rows by the header, but the " + std::to_string(source_.remaining()) +
                         " bytes left can hold no more than " +
                         std::to_string(source_.remaining() / min_row_bytes));
    }
    for (PlyProperty& property : element_.properties) {
      if (property.is_list()) {
        property.list_begins.reserve(element_.num_rows + 1);
      } else {
        std::visit([&](auto& values) { values.resize(element_.num_rows); }, property.values);
      }
    }
    if (has_list) {
      for (uint64_t row = 0; row < element_.num_rows; ++row) ReadRow(row);
    } else {
      ReadFixedRows(min_row_bytes);
    }
  }

 private:
  void ReadFixedRows(uint64_t row_bytes) {
    constexpr uint64_t kBlockBytes = uint64_t{1} << 17;  // fits the cache of a core
    const uint64_t rows_per_block = std::max<uint64_t>(1, kBlockBytes / row_bytes);
    for (uint64_t row = 0; row < element_.num_rows; row += rows_per_block) {
      const uint64_t count = std::min(rows_per_block, element_.num_rows - row);
      const char* bytes = source_.Take(count * row_bytes, element_.name);
      for (PlyProperty& property : element_.properties) {
        std::visit([&](auto& values) { LoadColumn<kSwap>(bytes, row_bytes, count, values.data() + row); },
                   property.values);
        bytes += PlyTypeSize(property.type());
      }
    }
  }

  void ReadRow(uint64_t row) {
    for (PlyProperty& property : element_.properties) {
      const size_t item_bytes = PlyTypeSize(property.type());
      if (!property.is_list()) {
        const char* bytes = Take(item_bytes, row, property);
        std::visit([&](auto& values) { LoadColumn<kSwap>(bytes, item_bytes, 1, values.data() + row); },
                   property.values);
        continue;
      }
      const PlyType size_type = *property.list_size_type;
      const int64_t size = LoadInteger<kSwap>(size_type, Take(PlyTypeSize(size_type), row, property));
      if (size < 0 || static_cast<uint64_t>(size) > source_.remaining() / item_bytes) {
        source_.FailAtByte("the list has " + std::to_string(size) +
                           " items, which the rest of the file cannot hold, in " +
                           CellName(element_, row, property));
      }
      const char* bytes = Take(static_cast<uint64_t>(size) * item_bytes, row, property);
      std::visit(
          [&](auto& values) {
            const size_t begin = values.size();
            values.resize(begin + static_cast<size_t>(size));
            LoadColumn<kSwap>(bytes, item_bytes, static_cast<uint64_t>(size), values.data() + begin);
            property.list_begins.push_back(values.size());
          },
          property.values);
    }
  }

  const char* Take(uint64_t count, uint64_t row, const PlyProperty& property) {
    // The name is put together only for a message.
    if (count > source_.remaining()) source_.Take(count, CellName(element_, row, property));
    return source_.Take(count, {});
  }

  PlySource& source_;
  PlyElement& element_;
};

void ExpectEnd(PlySource& source, PlyFormat format) {
  if (format != PlyFormat::kAscii) {
    if (source.remaining() > 0) {
      source.FailAtByte(std::to_string(source.remaining()) + " bytes follow after the last element");
    }
    return;
  }
  while (source.remaining() > 0) {
    const std::string_view line = source.TakeLine(kNoLimit);
    if (!std::all_of(line.begin(), line.end(), IsBlank)) {
      source.FailAtLine(Quoted(line) + " follows after the last element");
    }
  }
}

}  // namespace

PlyFile ReadPly(std::istream& stream, const std::filesystem::path& path) {
  PlySource source(stream, path);
  PlyFile file = HeaderReader(source).Read();
  for (PlyElement& element : file.elements) {
    switch (file.format) {
      case PlyFormat::kAscii:
        TextRows(source, element).Read();
        break;
      case PlyFormat::kBinaryLittleEndian:
        BinaryRows<false>(source, element).Read();
        break;
      case PlyFormat::kBinaryBigEndian:
        BinaryRows<true>(source, element).Read();
        break;
    }
  }
  ExpectEnd(source, file.format);
  return file;
}

PlyFile ReadPly(const std::filesystem::path& path) {
  std::ifstream stream = OpenForReading(path);
  return ReadPly(stream, path);
}

}  // namespace s2gs
