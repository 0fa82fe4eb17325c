#include "plugin/colmap/child_process.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/resource.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <string>
#include <vector>

#include "sfm_split/base/error.h"

namespace s2gs {
namespace {

// What the user is told when a program does not start; "" when it does.
std::string FaultOf(const std::string& program) {
  try {
    RunChild(
        {{program}, {}}, {}, [](const ChildOutput&) {}, [] { return false; });
  } catch (const UserError& error) {
    return error.what();
  }
  return "";
}

// A program starts through pipes: with no file descriptor left there are none.
TEST(ChildProcess, CannotStartWithoutFileDescriptors) {
  rlimit limit{};
  ASSERT_EQ(::getrlimit(RLIMIT_NOFILE, &limit), 0);
  const rlimit few{64, limit.rlim_max};
  ASSERT_EQ(::setrlimit(RLIMIT_NOFILE, &few), 0);
  std::vector<int> taken;
  for (int fd = ::dup(STDERR_FILENO); fd >= 0; fd = ::dup(STDERR_FILENO)) taken.push_back(fd);
  EXPECT_EQ(errno, EMFILE);
  const std::string fault = FaultOf("/bin/true");
  for (const int fd : taken) ::close(fd);
  ASSERT_EQ(::setrlimit(RLIMIT_NOFILE, &limit), 0);
  EXPECT_THAT(fault, ::testing::HasSubstr(std::string("cannot be started (") + std::strerror(EMFILE)));
  EXPECT_EQ(FaultOf("/bin/true"), "");
}

}  // namespace
}  // namespace s2gs
