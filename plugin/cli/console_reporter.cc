#include "plugin/cli/console_reporter.h"

#include <fmt/format.h>
#include <spdlog/logger.h>
#include <spdlog/sinks/base_sink.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <mutex>
#include <utility>

#include "plugin/cli/interrupt.h"
#include "sfm_split/base/printable.h"
#include "sfm_split/base/stopwatch.h"

namespace s2gs {
namespace {

constexpr double kRedrawSeconds = 0.1;  // between two drawings of a bar
constexpr double kMinLineSeconds = 5;   // between two plain lines
constexpr double kMaxLineSeconds = 60;  // after which a plain line is due whatever was done
constexpr double kLineFraction = 0.1;   // of the work, between two plain lines
constexpr double kRateSeconds = 15;     // over which a task's rate is averaged
constexpr int kBarWidth = 24;
constexpr int kDefaultColumns = 80;

spdlog::level::level_enum ToSpdlog(LogLevel level) {
  switch (level) {
    case LogLevel::kDebug:
      return spdlog::level::debug;
    case LogLevel::kInfo:
      return spdlog::level::info;
    case LogLevel::kWarning:
      return spdlog::level::warn;
    case LogLevel::kError:
      return spdlog::level::err;
  }
  return spdlog::level::info;
}

// Three significant digits: 0.0123, 1.23, 12.3, 123, 12300.
std::string FormatRate(double per_second) {
  if (per_second >= 100) return fmt::format("{:.0f}", per_second);
  return fmt::format("{:.3g}", per_second);
}

// A sink that keeps one line, the progress bar, below everything that is logged.
class ConsoleSink : public spdlog::sinks::base_sink<std::mutex> {
 public:
  ConsoleSink(std::FILE* stream, const ConsoleStyle& style, std::function<double()> seconds)
      : stream_(stream), style_(style), seconds_(std::move(seconds)), start_(seconds_()) {}

  // Replaces the bar; an empty one takes it away.
  void SetBar(const std::string& bar) {
    const std::lock_guard<std::mutex> lock(mutex_);
    std::string text = EraseBar();
    bar_ = bar.substr(0, bar.find('\n'));
    const int columns = style_.num_columns > 0 ? style_.num_columns : kDefaultColumns;
    // A bar that fills the last column would wrap, and could then not be erased.
    if (bar_.size() >= static_cast<size_t>(columns)) bar_.resize(columns > 1 ? columns - 1 : 0);
    Write(text + bar_);
  }

 protected:
  void sink_it_(const spdlog::details::log_msg& message) override {
    std::string label;
    std::string color;
    switch (message.level) {
      case spdlog::level::debug:
        label = "debug: ";
        color = "\x1b[2m";
        break;
      case spdlog::level::warn:
        label = "warning: ";
        color = "\x1b[33m";
        break;
      case spdlog::level::err:
        label = "error: ";
        color = "\x1b[31m";
        break;
      default:
        break;
    }
    // Names and other programs' output may hold what a terminal takes for a command.
    std::string line = fmt::format("[{:.1f}s] {}{}", seconds_() - start_, label,
                                   Printable({message.payload.data(), message.payload.size()}));
    if (style_.has_color && !color.empty()) line = color + line + "\x1b[0m";
    Write(EraseBar() + line + "\n" + bar_);
  }
  void flush_() override { std::fflush(stream_); }

 private:
  std::string EraseBar() const { return bar_.empty() ? "" : "\r\x1b[K"; }
  void Write(const std::string& text) {
    std::fwrite(text.data(), 1, text.size(), stream_);
    std::fflush(stream_);
  }

  std::FILE* stream_;
  ConsoleStyle style_;
  std::function<double()> seconds_;
  double start_;
  std::string bar_;
};

}  // namespace

ConsoleStyle StyleFor(std::FILE* stream) {
  ConsoleStyle style;
  const int fd = ::fileno(stream);
  if (fd < 0 || ::isatty(fd) == 0) return style;
  const char* terminal = std::getenv("TERM");
  if (terminal == nullptr || std::string_view(terminal) == "dumb") return style;
  const char* no_color = std::getenv("NO_COLOR");
  style.has_bars = true;
  style.has_color = no_color == nullptr || *no_color == '\0';
  struct winsize size = {};
  if (::ioctl(fd, TIOCGWINSZ, &size) == 0) style.num_columns = size.ws_col;
  return style;
}

std::string FormatDuration(double seconds) {
  if (!std::isfinite(seconds) || seconds < 0) return "?";
  if (seconds < 60 && std::round(seconds * 10) < 600) return fmt::format("{:.1f}s", seconds);
  const auto whole = static_cast<int64_t>(std::min(std::round(seconds), 1e15));
  if (whole < 3600) return fmt::format("{}m {:02}s", whole / 60, whole % 60);
  return fmt::format("{}h {:02}m", whole / 3600, whole % 3600 / 60);
}

class ConsoleReporter::Impl {
 public:
  Impl(LogLevel level, std::FILE* stream, const ConsoleStyle& style, std::function<double()> seconds)
      : has_bars_(style.has_bars),
        shows_progress_(level <= LogLevel::kInfo),
        seconds_(std::move(seconds)),
        sink_(std::make_shared<ConsoleSink>(stream, style, seconds_)),
        logger_("s2gs", sink_) {
    logger_.set_level(ToSpdlog(level));
  }
  ~Impl() { EndTask(); }

  void Log(LogLevel level, std::string_view message) {
    logger_.log(ToSpdlog(level), spdlog::string_view_t(message.data(), message.size()));
  }

  void Progress(std::string_view task, int64_t done, int64_t total) {
    if (!shows_progress_) return;
    const double now = seconds_();
    if (task != task_ || done < done_) {
      EndTask();
      task_ = task;
      begin_ = rate_begin_ = last_shown_ = now;
      rate_done_ = last_shown_done_ = done;
      rate_ = 0;
      if (has_bars_) sink_->SetBar(Bar(done, total, now));
    }
    done_ = done;
    UpdateRate(done, now);
    if (total > 0 && done >= total) {
      const double seconds = now - begin_;
      EndTask();
      if (seconds >= kMinLineSeconds) {
        logger_.info("{}: {} in {}", std::string(task), total, FormatDuration(seconds));
      }
      return;
    }
    const double since = now - last_shown_;
    if (has_bars_ && since >= kRedrawSeconds) {
      sink_->SetBar(Bar(done, total, now));
    } else if (!has_bars_ && since >= kMinLineSeconds) {
      const bool is_far = total > 0 && static_cast<double>(done - last_shown_done_) >=
                                           kLineFraction * static_cast<double>(total);
      if (!is_far && since < kMaxLineSeconds) return;
      logger_.info("{}", Line(done, total));
    } else {
      return;
    }
    last_shown_ = now;
    last_shown_done_ = done;
  }

 private:
  void EndTask() {
    if (has_bars_ && !task_.empty()) sink_->SetBar("");
    task_.clear();
    done_ = 0;
  }

  // A moving average, so that the time left follows a rate that drifts.
  void UpdateRate(int64_t done, double now) {
    const double interval = now - rate_begin_;
    if (interval < kRedrawSeconds) return;
    const double rate = static_cast<double>(done - rate_done_) / interval;
    // As long as the task is young, the plain average.
    const double weight = std::max(1 - std::exp(-interval / kRateSeconds), interval / (now - begin_));
    rate_ += std::min(weight, 1.0) * (rate - rate_);
    rate_begin_ = now;
    rate_done_ = done;
  }

  std::string Rate(int64_t done, int64_t total) const {
    if (rate_ <= 0) return "";
    std::string text = ", " + FormatRate(rate_) + "/s";
    if (total > 0) text += ", " + FormatDuration(static_cast<double>(total - done) / rate_) + " left";
    return text;
  }

  std::string Line(int64_t done, int64_t total) const {
    if (total <= 0) return fmt::format("{}: {}{}", task_, done, Rate(done, total));
    return fmt::format("{}: {}/{} ({:.0f} %){}", task_, done, total,
                       100.0 * static_cast<double>(done) / static_cast<double>(total), Rate(done, total));
  }

  std::string Bar(int64_t done, int64_t total, double now) const {
    if (total <= 0)
      return fmt::format("{}: {}{}, {}", task_, done, Rate(done, total), FormatDuration(now - begin_));
    const double fraction = std::clamp(static_cast<double>(done) / static_cast<double>(total), 0.0, 1.0);
    const int full = static_cast<int>(fraction * kBarWidth);
    return fmt::format("{} [{}{}] {:3.0f} % {}/{}{}", task_, std::string(full, '#'),
                       std::string(kBarWidth - full, '.'), std::floor(100 * fraction), done, total,
                       Rate(done, total));
  }

  bool has_bars_;
  bool shows_progress_;
  std::function<double()> seconds_;
  std::shared_ptr<ConsoleSink> sink_;
  spdlog::logger logger_;

  std::string task_;  // empty between tasks
  int64_t done_ = 0;
  double begin_ = 0;       // [s]
  double last_shown_ = 0;  // [s]
  int64_t last_shown_done_ = 0;
  double rate_begin_ = 0;  // [s]
  int64_t rate_done_ = 0;
  double rate_ = 0;  // [units/s]
};

ConsoleReporter::ConsoleReporter(LogLevel level)
    : ConsoleReporter(level, stderr, StyleFor(stderr), SteadySeconds) {}

ConsoleReporter::ConsoleReporter(LogLevel level, std::FILE* stream, const ConsoleStyle& style,
                                 std::function<double()> seconds)
    : impl_(std::make_unique<Impl>(level, stream, style, std::move(seconds))) {}

ConsoleReporter::~ConsoleReporter() = default;

void ConsoleReporter::Log(LogLevel level, std::string_view message) { impl_->Log(level, message); }

void ConsoleReporter::Progress(std::string_view task, int64_t done, int64_t total) {
  impl_->Progress(task, done, total);
}

bool ConsoleReporter::StopRequested() const { return InterruptRequested(); }

}  // namespace s2gs
