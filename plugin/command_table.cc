#include "plugin/command.h"
#include "plugin/motion_splitter_command.h"
#include "plugin/scan_evaluator_command.h"
#include "plugin/turntable_mapper_command.h"
#include "plugin/workspace_info_command.h"

namespace s2gs {

const std::vector<Command>& AllCommands() {
  static const std::vector<Command> commands = {
#if S2GS_WITH_SFM
      {"motion_splitter", "splits features into static and rotating: two databases for colmap mapper",
       RunMotionSplitter},
#endif
      {"scan_evaluator", "measures a workspace or rendered images against ground truth", RunScanEvaluator},
#if S2GS_WITH_SFM
      {"turntable_mapper", "maps both databases with colmap and aligns them: sparse models, turntable.json",
       RunTurntableMapper},
#endif
      {"workspace_info", "lists the stages of a workspace, which are done and why not, and its files",
       RunWorkspaceInfo},
  };
  return commands;
}

}  // namespace s2gs
