#include "plugin/shared_options/backend_choice.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <memory>
#include <string>

#include "sfm_split/base/error.h"
#include "sfm_split/base/keeping_reporter.h"

namespace s2gs {
namespace {

std::string TextOf(const KeepingReporter& reporter) {
  std::string text;
  for (const auto& [level, message] : reporter.messages()) text += message + "\n";
  return text;
}

// No machine has a GPU of the second index; whether it has one of the first it is asked.
TEST(MakeBackend, TakesTheCpuWhereNoGpuCanBeUsedUnlessOneIsAskedFor) {
  const Reporter asked;
  for (const int index : {0, 1000}) {
    BackendChoice choice;
    choice.gpu_index = index;
    const std::string problem = GpuProblem(choice);
    EXPECT_TRUE(index == 0 || !problem.empty());
    KeepingReporter reporter(asked);
    EXPECT_EQ(MakeBackend(choice, reporter)->Info().kind,
              problem.empty() ? BackendKind::kCuda : BackendKind::kCpu);
    EXPECT_EQ(TextOf(reporter).find("computing on the CPU: ") != std::string::npos, !problem.empty());
    EXPECT_THAT(TextOf(reporter), testing::HasSubstr(problem));
    choice.use_gpu = UseGpu::kYes;
    if (problem.empty()) {
      EXPECT_EQ(MakeBackend(choice, reporter)->Info().kind, BackendKind::kCuda);
    } else {
      EXPECT_THROW(MakeBackend(choice, reporter), UserError);
    }
    choice.use_gpu = UseGpu::kNo;
    KeepingReporter of_cpu(asked);
    EXPECT_EQ(MakeBackend(choice, of_cpu)->Info().kind, BackendKind::kCpu);
    EXPECT_EQ(TextOf(of_cpu).find("computing on the CPU: "), std::string::npos);
  }
}

}  // namespace
}  // namespace s2gs
