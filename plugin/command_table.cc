#include "plugin/command.h"
#include "plugin/workspace_info_command.h"

namespace s2gs {

const std::vector<Command>& AllCommands() {
  static const std::vector<Command> commands = {
      {"workspace_info", "lists the stages of a workspace, which are done and why not, and its files",
       RunWorkspaceInfo},
  };
  return commands;
}

}  // namespace s2gs
