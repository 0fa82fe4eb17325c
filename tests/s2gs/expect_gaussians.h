#pragma once

#include <gtest/gtest.h>

#include "s2gs/core/gaussians.h"

namespace s2gs {

/// Bit for bit, every parameter.
inline void ExpectSameGaussians(const Gaussians& a, const Gaussians& b) {
  ASSERT_EQ(a.size(), b.size());
  EXPECT_EQ(a.sh_degree, b.sh_degree);
  EXPECT_EQ(a.centre, b.centre);
  EXPECT_EQ(a.log_scale, b.log_scale);
  EXPECT_EQ(a.rotation, b.rotation);
  EXPECT_EQ(a.opacity_logit, b.opacity_logit);
  EXPECT_EQ(a.sh_dc, b.sh_dc);
  EXPECT_EQ(a.sh_rest, b.sh_rest);
  EXPECT_EQ(a.foreground_logit, b.foreground_logit);
}

}  // namespace s2gs
