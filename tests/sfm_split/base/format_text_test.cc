#include "sfm_split/base/format_text.h"

#include <gtest/gtest.h>

#include <string>

namespace s2gs {
namespace {

TEST(FormatText, IsPrintfsAndEndsAtItsBound) {
  EXPECT_EQ(FormatText("%d of %s: %.2f %%", 3, "seven", 42.857), "3 of seven: 42.86 %");
  EXPECT_EQ(FormatText("%s", std::string(400, 'x').c_str()), std::string(255, 'x'));
}

}  // namespace
}  // namespace s2gs
