#include "plugin/cli/command.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <csignal>
#include <cstdlib>
#include <filesystem>
#include <new>
#include <stdexcept>

#include "plugin/cli/version.h"
#include "sfm_split/base/error.h"
#include "tests/plugin/commands/subprocess.h"

namespace s2gs {
namespace {

using ::testing::AllOf;
using ::testing::ExitedWithCode;
using ::testing::HasSubstr;
using ::testing::KilledBySignal;

Reporter& ParseNothing(CommandContext& context) {
  context.Declare("Does something.", "");
  return context.Parse();
}

const std::vector<Command> kCommands = {
    {"print", "prints a line",
     [](CommandContext& c) {
       ParseNothing(c);
       c.out() << "a result\n";
     }},
    {"user_error", "fails",
     [](CommandContext& c) {
       ParseNothing(c);
       throw UserError("scan/a.bin", "ends at byte 3", "Restore it");
     }},
    {"bad_line", "finds a wrong line",
     [](CommandContext& c) {
       ParseNothing(c);
       throw CommandLineError("--a and --b exclude each other");
     }},
    {"interrupted", "stops",
     [](CommandContext& c) {
       ParseNothing(c);
       throw Interrupted();
     }},
    {"out_of_memory", "needs too much",
     [](CommandContext& c) {
       ParseNothing(c);
       throw std::bad_alloc();
     }},
    {"file_system", "stumbles",
     [](CommandContext& c) {
       ParseNothing(c);
       static_cast<void>(std::filesystem::file_size("/no/such/file"));
     }},
    {"defect", "is wrong",
     [](CommandContext& c) {
       ParseNothing(c);
       throw std::logic_error("index out of range");
     }},
    {"invariant", "is wrong",
     [](CommandContext& c) {
       ParseNothing(c);
       S2GS_INVARIANT(1 + 1 == 3);
     }},
    {"raise_once", "is asked to stop",
     [](CommandContext& c) {
       const Reporter& reporter = ParseNothing(c);
       if (reporter.StopRequested()) throw UserError("asked too early");
       ::raise(SIGINT);
       if (reporter.StopRequested()) throw Interrupted();
     }},
    {"raise_twice", "is asked to stop at once",
     [](CommandContext& c) {
       ParseNothing(c);
       ::raise(SIGTERM);
       ::raise(SIGINT);
       throw UserError("went on");
     }},
};

int Execute(const std::vector<std::string>& arguments) { return RunProgram(kCommands, arguments); }

// Runs the program in this process; returns what it printed to the standard output.
std::string OutputOf(const std::vector<std::string>& arguments) {
  ::testing::internal::CaptureStdout();
  const int code = Execute(arguments);
  std::string out = ::testing::internal::GetCapturedStdout();
  EXPECT_EQ(code, 0) << out;
  return out;
}

TEST(RunProgram, ListsCommandsAndExitCodes) {
  for (const std::vector<std::string>& arguments :
       {std::vector<std::string>{}, {"help"}, {"-h"}, {"--help"}}) {
    const std::string help = OutputOf(arguments);
    for (const Command& command : kCommands)
      EXPECT_THAT(help, AllOf(HasSubstr("  " + command.name + " "), HasSubstr(command.summary)));
    for (const std::string code : {"    0  ", "    1  ", "    2  ", "  130  ", "  134  "})
      EXPECT_THAT(help, HasSubstr(code));
  }
}

TEST(RunProgram, ExplainsOneCommand) {
  const std::string help = OutputOf({"print", "-h"});
  EXPECT_THAT(help, HasSubstr("s2gs print: Does something."));
  EXPECT_EQ(OutputOf({"help", "print"}), help);
  EXPECT_EQ(OutputOf({"--help", "print"}), help);
  EXPECT_EQ(OutputOf({"print", "--help"}), help);
}

TEST(RunProgram, PrintsItsVersion) {
  EXPECT_THAT(OutputOf({"--version"}), ::testing::StartsWith(VersionText() + "\n"));
  EXPECT_THAT(VersionText(),
              ::testing::MatchesRegex(
                  "s2gs [0-9]+\\.[0-9]+\\.[0-9]+ \\((no CUDA|CUDA [0-9.]+), with(out)? SfM, .+ build\\)"));
}

TEST(RunProgram, ReturnsZeroForResults) { EXPECT_EQ(OutputOf({"print"}), "a result\n"); }

struct Ending {
  std::vector<std::string> arguments;
  int code;
  std::string message;
};

TEST(RunProgramDeathTest, ExitCodes) {
  // Libraries that read photos start threads when they are loaded, which a fork alone would not take along:
  // whatever ends there would wait for them.
  testing::FLAGS_gtest_death_test_style = "threadsafe";
  const std::vector<Ending> endings = {
      {{"user_error"}, 1, "error: scan/a.bin: ends at byte 3. Restore it"},
      {{"out_of_memory"}, 1, "out of memory"},
      {{"file_system"}, 1, "/no/such/file"},
      {{"bad_line"}, 2, "exclude each other"},
      {{"print", "--a", "1"}, 2, "unknown option --a"},
      {{"prnit"}, 2, "unknown command prnit. Did you mean print"},
      {{"help", "defetc"}, 2, "Did you mean defect"},
      {{"xyzzy"}, 2, "unknown command xyzzy."},
      {{"interrupted"}, 130, "the same command goes on"},
      {{"raise_once"}, 130, "stopping at the next safe point"},
      {{"raise_twice"}, 130, "stopping at the next safe point"},
  };
  for (const auto& [arguments, code, message] : endings) {
    EXPECT_EXIT(std::exit(Execute(arguments)), ExitedWithCode(code), message) << arguments[0];
  }
  EXPECT_EXIT(std::exit(Execute({"defect"})), KilledBySignal(SIGABRT),
              "index out of range\nThis is a defect in s2gs");
  EXPECT_EXIT(std::exit(Execute({"invariant"})), KilledBySignal(SIGABRT), "broken invariant .*1 \\+ 1 == 3");
}

// Works until it is asked to stop.
std::function<void()> say_started;
void RunForever(CommandContext& context) {
  const Reporter& reporter = ParseNothing(context);
  say_started();
  while (!reporter.StopRequested()) ::usleep(1000);
  throw Interrupted();
}

TEST(Interrupt, StopsARunningCommand) {
  for (const int signal : {SIGINT, SIGTERM}) {
    ChildProcess child([](const std::function<void()>& say_ready) {
      say_started = say_ready;
      return RunProgram({{"forever", "", RunForever}}, {"forever"});
    });
    ASSERT_TRUE(child.WaitUntilReady());
    child.Signal(signal);
    EXPECT_EQ(child.Wait(), 130);
  }
}

// Never asks whether it should stop.
void RunDeaf(CommandContext& context) {
  ParseNothing(context);
  say_started();
  while (true) ::usleep(1000);
}

TEST(Interrupt, SecondSignalEndsAtOnce) {
  ChildProcess child([](const std::function<void()>& say_ready) {
    say_started = say_ready;
    return RunProgram({{"deaf", "", RunDeaf}}, {"deaf"});
  });
  ASSERT_TRUE(child.WaitUntilReady());
  child.Signal(SIGINT);
  // Pending signals of one kind merge, so the second is of the other.
  child.Signal(SIGTERM);
  EXPECT_EQ(child.Wait(), 130);
}

TEST(Interrupt, IgnoredSignalsStayIgnored) {
  ChildProcess child([](const std::function<void()>& say_ready) {
    ::signal(SIGINT, SIG_IGN);
    say_started = say_ready;
    return RunProgram({{"forever", "", RunForever}}, {"forever"});
  });
  ASSERT_TRUE(child.WaitUntilReady());
  child.Signal(SIGINT);
  child.Signal(SIGINT);
  child.Signal(SIGINT);
  // The first that counts: with the others it would have ended at once, without its own exit code path.
  child.Signal(SIGTERM);
  EXPECT_EQ(child.Wait(), 130);
}

}  // namespace
}  // namespace s2gs
