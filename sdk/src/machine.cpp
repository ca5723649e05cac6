#include "machine.h"

#include <algorithm>
#include <climits>
#include <cmath>
#include <fstream>
#include <sstream>
#include <string>

#include <oneapi/tbb/info.h>

namespace pathfold::core {
namespace {

namespace fs = std::filesystem;

/// Time over period; INT_MAX where there is no bound: "max", -1, or no such file.
int rounded_up(double time, double period) {
    return time > 0 && period > 0 ? int(std::min(std::ceil(time / period), double(INT_MAX))) : INT_MAX;
}

double read_number(const fs::path &path) {
    double number = -1;
    std::ifstream(path) >> number;
    return number;
}

/// Of one group, in the files of either version.
int quota_in(const fs::path &group) {
    std::ifstream file(group / "cpu.max");
    double time = -1, period = -1;
    if (file >> time >> period)
        return rounded_up(time, period);
    return rounded_up(read_number(group / "cpu.cfs_quota_us"), read_number(group / "cpu.cfs_period_us"));
}

/// The least of a group's and of those that it is in. In a container the group's own path may not be visible.
int quota_along(const fs::path &mount, const std::string &group) {
    int least = quota_in(mount);
    fs::path at = mount;
    for (const fs::path &name : fs::path(group).relative_path())
        least = std::min(least, quota_in(at /= name));
    return least;
}

bool has_word(const std::string &list, const std::string &word) {
    return ("," + list + ",").find("," + word + ",") != std::string::npos;
}

} // namespace

int quota_of_processors(const fs::path &root) {
    const fs::path mounts = root / "sys/fs/cgroup";
    std::ifstream file(root / "proc/self/cgroup");
    int least = INT_MAX;
    for (std::string line; std::getline(file, line);) { // number:controllers:path
        std::istringstream parts(line);
        std::string number, controllers, group;
        std::getline(parts, number, ':');
        std::getline(parts, controllers, ':');
        std::getline(parts, group);
        if (controllers.empty())
            least = std::min(least, quota_along(mounts, group));
        else if (has_word(controllers, "cpu"))
            for (const std::string &mount : {controllers, std::string("cpu")})
                least = std::min(least, quota_along(mounts / mount, group));
    }
    return least;
}

int available_processors() {
    return std::max(1, std::min(oneapi::tbb::info::default_concurrency(), quota_of_processors()));
}

} // namespace pathfold::core
