#include <Eigen/Core>

#include "plugin/cli/command.h"
#include "sfm_split/base/machine_share.h"

int main(int argc, char** argv) {
  // Eigen's own threads wait for each other spinning: where cores are shared, a product of two matrices then
  // takes longer than all that surrounds it. What is worth several threads is divided by ParallelFor.
  Eigen::setNbThreads(1);
  s2gs::UseNoMoreThanUsableCores();
  return s2gs::RunProgram(s2gs::AllCommands(), {argv + (argc > 0 ? 1 : 0), argv + argc});
}
