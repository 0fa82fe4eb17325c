#include "s2gs/core/vec.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>

#include "tests/support/random_numbers.h"

namespace s2gs {
namespace {

TEST(RotationMatrix, IsEigensOfTheNormalisedQuaternion) {
  RandomNumbers random(5);
  for (int i = 0; i < 100; ++i) {
    const Eigen::Quaterniond q(random.Normal(), random.Normal(), random.Normal(), random.Normal());
    const Mat3<double> m = RotationMatrix(Quat<double>{q.w(), q.x(), q.y(), q.z()}, 1 / q.norm());
    Eigen::Matrix3d by_columns;
    by_columns << m.x.x, m.y.x, m.z.x, m.x.y, m.y.y, m.z.y, m.x.z, m.y.z, m.z.z;
    EXPECT_LT((by_columns - q.normalized().toRotationMatrix()).norm(), 1e-14);  // 8e-16 measured
  }
}

}  // namespace
}  // namespace s2gs
