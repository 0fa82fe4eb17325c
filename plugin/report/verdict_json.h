#pragma once

#include <nlohmann/json.hpp>
#include <ostream>

#include "sfm_split/evidence/verdict.h"

namespace s2gs {

/// {"verdict": "good" | "doubtful" | "failed", "reasons": [...], "advice": [...], "measured": {...}}; what
/// was not measured, and what is infinite, is null.
nlohmann::json ToJson(const ScanVerdict& verdict, const ScanEvidence& evidence);

/// The same for people, from its JSON; nothing where that has no verdict.
void PrintVerdict(const nlohmann::json& verdict, std::ostream& out);

}  // namespace s2gs
