// Files as the kernel writes them, for both versions of control groups.

#include "sfm_split/base/machine_share.h"

#include <gtest/gtest.h>
#include <omp.h>
#include <sched.h>

#include <limits>
#include <string>
#include <thread>

#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

class ControlGroups : public testing::Test {
 protected:
  void Write(const std::string& name, const std::string& text) const {
    std::filesystem::create_directories((folder_ / name).parent_path());
    folder_.Write(name, text);
  }
  ControlGroupFiles Files() const { return {folder_ / "cgroup", folder_ / "mount"}; }

  const TemporaryFolder folder_;
};

TEST_F(ControlGroups, NothingWhereNothingBounds) {
  EXPECT_FALSE(ControlGroupCores(Files()));
  EXPECT_FALSE(ControlGroupMemoryBytes(Files()));
  Write("cgroup", "0::/job\n");
  Write("mount/job/cpu.max", "max 100000\n");
  Write("mount/job/memory.max", "max\n");
  Write("mount/job/memory.current", "5\n");
  EXPECT_FALSE(ControlGroupCores(Files()));
  EXPECT_FALSE(ControlGroupMemoryBytes(Files()));
}

// A job of a batch system: its group has no limit of its own, the one above it has.
TEST_F(ControlGroups, TheLeastOfAllAbove) {
  Write("cgroup", "0::/slurm/job_7/step_0\n");
  Write("mount/cpu.max", "1600000 100000\n");
  Write("mount/slurm/job_7/cpu.max", "250000 100000\n");
  Write("mount/slurm/job_7/step_0/cpu.max", "max 100000\n");
  Write("mount/memory.max", "max\n");
  Write("mount/slurm/job_7/memory.max", "1000000\n");
  Write("mount/slurm/job_7/memory.current", "700000\n");
  Write("mount/slurm/job_7/memory.stat", "anon 300000\ninactive_file 400000\nactive_file 5\n");
  EXPECT_EQ(ControlGroupCores(Files()), 2.5);
  EXPECT_EQ(ControlGroupMemoryBytes(Files()), 700'000U);
}

// A container sees its own limits at the mount, and its path as on the host, or from elsewhere.
TEST_F(ControlGroups, AContainersOwn) {
  for (const char* path : {"/kubepods/pod1", "/../../pod1", "/"}) {
    Write("cgroup", std::string("0::") + path + "\n");
    Write("mount/cpu.max", "50000 100000\n");
    Write("mount/memory.max", "4096\n");
    Write("mount/memory.current", "8192\n");  // above the limit for a moment
    EXPECT_EQ(ControlGroupCores(Files()), .5) << path;
    EXPECT_EQ(ControlGroupMemoryBytes(Files()), 0U) << path;
  }
}

TEST_F(ControlGroups, VersionOne) {
  Write("cgroup", "9:cpuset:/other\n4:cpu,cpuacct:/docker/ab\n3:memory:/docker/ab\n1:name=systemd:/x\n");
  Write("mount/cpu/docker/ab/cpu.cfs_quota_us", "300000\n");
  Write("mount/cpu/docker/ab/cpu.cfs_period_us", "100000\n");
  Write("mount/cpu/other/cpu.cfs_quota_us", "100000\n");
  Write("mount/cpu/other/cpu.cfs_period_us", "100000\n");
  Write("mount/cpu/cpu.cfs_quota_us", "-1\n");
  Write("mount/cpu/cpu.cfs_period_us", "100000\n");
  Write("mount/memory/docker/ab/memory.limit_in_bytes", "5000\n");
  Write("mount/memory/docker/ab/memory.usage_in_bytes", "2000\n");
  Write("mount/memory/docker/ab/memory.stat", "cache 9\ninactive_file 1\ntotal_inactive_file 500\n");
  Write("mount/memory/memory.limit_in_bytes", "9223372036854771712\n");
  EXPECT_EQ(ControlGroupCores(Files()), 3);
  EXPECT_EQ(ControlGroupMemoryBytes(Files()), 3500U);
}

TEST_F(ControlGroups, DamagedFilesBoundNothing) {
  Write("cgroup", "0\n0:\n:\n0::\nno colon\n");
  Write("mount/cpu.max", "100000\n");
  Write("mount/memory.max", "-3\n");
  EXPECT_FALSE(ControlGroupCores(Files()));
  EXPECT_FALSE(ControlGroupMemoryBytes(Files()));
}

TEST(MachineShare, AffinityBoundsCores) {
  // In a thread of its own, whose affinity goes with it.
  std::thread([] {
    cpu_set_t allowed;
    ASSERT_EQ(::sched_getaffinity(0, sizeof(allowed), &allowed), 0);
    int first = 0;
    while (!CPU_ISSET(first, &allowed)) ++first;
    CPU_ZERO(&allowed);
    CPU_SET(first, &allowed);
    ASSERT_EQ(::sched_setaffinity(0, sizeof(allowed), &allowed), 0);
    EXPECT_EQ(UsableCores(), 1);
  }).join();
}

TEST(MachineShare, ThreadsFitIntoMemory) {
  EXPECT_EQ(ThreadsThatFit(0), omp_get_max_threads());
  EXPECT_EQ(ThreadsThatFit(std::numeric_limits<uint64_t>::max()), 1);
  const uint64_t available = AvailableMemoryBytes();
  EXPECT_GT(available, 0U);
  // What is free changes by less than a third between two looks.
  if (omp_get_max_threads() > 1) EXPECT_EQ(ThreadsThatFit(available * 2 / 3), 1);
}

}  // namespace
}  // namespace s2gs
