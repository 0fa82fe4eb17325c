#pragma once

#include <cstdint>

namespace s2gs {

/// How many of `all` matches must agree with a photo's place before chance does not explain them: of so many
/// independent `hypotheses` the best one is agreed with by as many, where every match agrees with a wrong
/// one with probability `by_chance`, in at most `risk` of all cases (the binomial distribution's tail times
/// the number of hypotheses).
/// \return  all + 1 where not even all of them would do.
int64_t LeastAgreeingMatches(int64_t all, double by_chance, double hypotheses, double risk);

}  // namespace s2gs
