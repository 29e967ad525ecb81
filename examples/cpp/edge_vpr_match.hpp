// Reads the matches of `edge-vpr stream --json`, and of its /events over HTTP, in C++17 without a dependency.
//
//     edge_vpr::Reader reader;
//     for (std::string line; std::getline(std::cin, line);)
//         if (const auto match = reader.read(line); match && !match->lost) steer(*match);
//
// std::from_chars reads the numbers, so no locale changes them. It needs GCC 11, Visual Studio 2019 16.4, or Clang
// with the library of either. docs/outputs.md describes the rows; their `kind` comes first.
#pragma once

#include <charconv>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <variant>

namespace edge_vpr {

using Real = std::optional<double>;
using Integer = std::optional<std::int64_t>;

/// One match. An optional member is empty if the row has null or no such field.
struct Match {
    double time_s = 0;         ///< end of the matched window, seconds on the camera's clock
    std::int64_t place = 0;    ///< place on the map, from 0
    bool lost = true;          ///< true: do not steer by it
    Real probability;          ///< probability that the place is right, 0 to 1
    Real missing;              ///< share of the events of its windows known to be lost, 0 to 1
    Real age_s;                ///< seconds from time_s to when the row was written
    Integer host_us;           ///< time_s on the clock of the machine that runs stream, microseconds since 1970
    Integer jumps;             ///< how often the position has jumped so far
    Real x_m, y_m, z_m;        ///< position at time_s in the frame of the map's track, metres
    Real latitude, longitude;  ///< position at time_s, degrees (WGS 84)
    Real heading_deg;          ///< direction of the route, degrees clockwise from north; in metres from y towards x
    Real along_m;              ///< position along the route at time_s, metres
    Real along_from_m;         ///< start of the interval around along_m, metres
    Real along_to_m;           ///< end of that interval, metres
    Real route_m;              ///< length of the whole route, metres
    Real distance;             ///< distance or metric of the place, lower is better
    Integer second;            ///< best place outside the exclusion zone, -1: none
    Real second_distance;      ///< distance or metric of that place
    Real ratio;                ///< distance / second_distance, from 0 (clear) to 1 (a tie)
    Integer events;            ///< events at the selected pixels in the newest window
    Real start_s;              ///< start of that window, seconds on the camera's clock
    Integer trust;             ///< higher is more confident
    Integer misfit;            ///< 64 or more: another place or light than the map's; -1: not known
};

namespace detail {

using Member = std::variant<double Match::*, std::int64_t Match::*, bool Match::*, Real Match::*, Integer Match::*>;

/// The fields that are read. A match without one of the first three is refused.
inline constexpr std::pair<std::string_view, Member> fields[] = {
    {"time_s", &Match::time_s}, {"place", &Match::place}, {"lost", &Match::lost},
    {"probability", &Match::probability}, {"missing", &Match::missing}, {"age_s", &Match::age_s},
    {"host_us", &Match::host_us}, {"jumps", &Match::jumps}, {"x_m", &Match::x_m}, {"y_m", &Match::y_m},
    {"z_m", &Match::z_m}, {"latitude", &Match::latitude}, {"longitude", &Match::longitude},
    {"heading_deg", &Match::heading_deg}, {"along_m", &Match::along_m}, {"along_from_m", &Match::along_from_m},
    {"along_to_m", &Match::along_to_m}, {"route_m", &Match::route_m}, {"distance", &Match::distance},
    {"second", &Match::second}, {"second_distance", &Match::second_distance}, {"ratio", &Match::ratio},
    {"events", &Match::events}, {"start_s", &Match::start_s}, {"trust", &Match::trust}, {"misfit", &Match::misfit}};

/// One JSON text. Each function takes the part that it names from the front of `rest`, and returns whether it was
/// there.
struct Json {
    std::string_view rest;

    bool take(char c) {
        if (rest.empty() || rest.front() != c) return false;
        rest.remove_prefix(1);
        return true;
    }
    void space() {
        while (take(' ') || take('\t') || take('\r') || take('\n')) {}
    }
    bool word(std::string_view w) {
        if (rest.substr(0, w.size()) != w) return false;
        rest.remove_prefix(w.size());
        return true;
    }
    /// Decodes ASCII; any other character that is escaped becomes '?', since no name of a field has one.
    bool string(std::string& out) {
        out.clear();
        if (!take('"')) return false;
        while (!rest.empty()) {
            char c = rest.front();
            rest.remove_prefix(1);
            if (c == '"') return true;
            if (static_cast<unsigned char>(c) < 0x20) return false;
            if (c == '\\') {
                constexpr std::string_view names = "\"\\/bfnrt", meant = "\"\\/\b\f\n\r\t";
                if (take('u')) {
                    unsigned code = 0;
                    const char* end = rest.data() + (rest.size() < 4 ? 0 : 4);
                    if (end == rest.data() || std::from_chars(rest.data(), end, code, 16).ptr != end) return false;
                    rest.remove_prefix(4);
                    c = code < 0x80 ? static_cast<char>(code) : '?';
                } else {
                    const auto at = rest.empty() ? names.npos : names.find(rest.front());
                    if (at == names.npos) return false;
                    rest.remove_prefix(1);
                    c = meant[at];
                }
            }
            out += c;
        }
        return false;
    }
    bool digits() {
        const auto size = rest.size();
        while (!rest.empty() && rest.front() >= '0' && rest.front() <= '9') rest.remove_prefix(1);
        return rest.size() < size;
    }
    bool number(std::string_view& text) {
        const std::string_view from = rest;
        take('-');
        if (!take('0') && !digits()) return false;
        if (take('.') && !digits()) return false;
        if (take('e') || take('E')) {
            if (!take('-')) take('+');
            if (!digits()) return false;
        }
        text = from.substr(0, from.size() - rest.size());
        return true;
    }
    /// `each(key)` takes the value of that key.
    template <class Each> bool object(Each each) {
        if (!take('{')) return false;
        if (space(), take('}')) return true;
        std::string key;
        do {
            if (space(), !string(key)) return false;
            if (space(), !take(':')) return false;
            if (space(), !each(key)) return false;
            space();
        } while (take(','));
        return take('}');
    }
    /// Any value, of at most `depth` nested objects and arrays.
    bool skip(int depth = 16) {
        std::string text;
        std::string_view digits;
        if (rest.empty()) return false;
        if (rest.front() == '"') return string(text);
        if (rest.front() != '{' && rest.front() != '[')
            return word("true") || word("false") || word("null") || number(digits);
        if (depth == 0) return false;
        if (!take('[')) return object([&](auto&) { return skip(depth - 1); });
        if (space(), take(']')) return true;
        do {
            if (space(), !skip(depth - 1)) return false;
            space();
        } while (take(','));
        return take(']');
    }

    bool value(bool& flag) { return (flag = word("true")) || word("false"); }
    template <class Number> bool value(Number& out) {
        std::string_view text;
        if (!number(text)) return false;
        const auto end = text.data() + text.size();
        const auto [ptr, error] = std::from_chars(text.data(), end, out);
        return error == std::errc() && ptr == end;
    }
    template <class Number> bool value(std::optional<Number>& out) { return word("null") || value(out.emplace()); }
};

inline bool share(const Real& x) { return !x || (*x >= 0 && *x <= 1); }

}  // namespace detail

/// Reads rows one by one.
class Reader {
public:
    std::uint64_t refused = 0;  ///< lines that are no row, such as incomplete ones

    /// The match of one line; nothing for a row of another kind, an empty line, or a line that is refused.
    std::optional<Match> read(std::string_view line) {
        detail::Json json{line};
        if (json.word("data:")) json.space();  // a server-sent event
        json.space();
        if (json.rest.empty() || json.rest.front() == ':') return {};
        Match match;
        std::string kind;
        std::uint32_t seen = 0;
        const auto field = [&](const std::string& key) {
            if (key == "kind") return kind.empty() && json.string(kind);
            if (kind != "match") return json.skip();
            std::uint32_t bit = 1;
            for (const auto& [name, member] : detail::fields) {
                if (key == name) {
                    if (seen & bit) return false;
                    seen |= bit;
                    return std::visit([&](auto part) { return json.value(match.*part); }, member);
                }
                bit <<= 1;
            }
            return json.skip();
        };
        const bool whole = json.object(field) && !kind.empty() && (json.space(), json.rest.empty());
        const bool sound = (seen & 7) == 7 && match.place >= 0 && detail::share(match.probability) &&
                           detail::share(match.missing);
        if (!whole || (kind == "match" && !sound)) return ++refused, std::nullopt;
        return kind == "match" ? std::optional(match) : std::nullopt;
    }
};

}  // namespace edge_vpr
