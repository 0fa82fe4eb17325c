#include "plugin/cli/command.h"

int main(int argc, char** argv) {
  return s2gs::RunProgram(s2gs::AllCommands(), {argv + (argc > 0 ? 1 : 0), argv + argc});
}
