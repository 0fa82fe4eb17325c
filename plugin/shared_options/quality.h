#pragma once

#include <cstdint>
#include <string>

#include "plugin/cli/options.h"

namespace s2gs {

/// How much time a scan may take.
enum class Quality : uint8_t { kAuto, kLow, kMedium, kHigh, kExtreme };

inline const EnumNames<Quality> kQualityNames = {{"auto", Quality::kAuto},
                                                 {"low", Quality::kLow},
                                                 {"medium", Quality::kMedium},
                                                 {"high", Quality::kHigh},
                                                 {"extreme", Quality::kExtreme}};

inline std::string QualityName(Quality quality) {
  for (const auto& [name, value] : kQualityNames) {
    if (value == quality) return name;
  }
  return "";
}

}  // namespace s2gs
