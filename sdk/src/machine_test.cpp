#include "machine.h"

#include <climits>

#include "testing.h"

namespace pathfold::core {
namespace {

/// A file system of a few files.
class Root {
public:
    Root() {
        const auto *test = testing::UnitTest::GetInstance()->current_test_info();
        path_ = std::filesystem::path(TEST_SCRATCH) / (std::string("Machine.") + test->name());
        std::filesystem::remove_all(path_);
    }
    Root &add(const std::string &file, const std::string &text) {
        std::filesystem::create_directories((path_ / file).parent_path());
        std::ofstream(path_ / file) << text;
        return *this;
    }
    int quota() const { return quota_of_processors(path_); }

private:
    std::filesystem::path path_;
};

} // namespace

TEST(Machine, NoGroupsNoBound) { EXPECT_EQ(Root().quota(), INT_MAX); }

TEST(Machine, QuotaOfVersion2) {
    Root root;
    root.add("proc/self/cgroup", "0::/slice/job\n");
    EXPECT_EQ(root.quota(), INT_MAX);
    root.add("sys/fs/cgroup/slice/job/cpu.max", "max 100000\n");
    EXPECT_EQ(root.quota(), INT_MAX);
    root.add("sys/fs/cgroup/slice/job/cpu.max", "350000 100000\n");
    EXPECT_EQ(root.quota(), 4);
    root.add("sys/fs/cgroup/slice/cpu.max", "200000 100000\n"); // of the group around it
    EXPECT_EQ(root.quota(), 2);
    root.add("sys/fs/cgroup/cpu.max", "1000 100000\n"); // a container's own
    EXPECT_EQ(root.quota(), 1);
}

TEST(Machine, QuotaOfVersion1) {
    for (const char *mount : {"cpu,cpuacct", "cpu"}) {
        Root root;
        root.add("proc/self/cgroup",
                 "5:memory:/docker/x\n3:cpu,cpuacct:/docker/x\n1:name=systemd:/docker/x\n");
        const std::string group = std::string("sys/fs/cgroup/") + mount + "/docker/x/";
        root.add(group + "cpu.cfs_quota_us", "-1\n").add(group + "cpu.cfs_period_us", "100000\n");
        EXPECT_EQ(root.quota(), INT_MAX);
        root.add(group + "cpu.cfs_quota_us", "150000\n");
        EXPECT_EQ(root.quota(), 2);
    }
}

TEST(Machine, AGroupThatCannotBeSeen) { // as in a container: its mount shows the group as the root
    Root root;
    root.add("proc/self/cgroup", "2:cpu:/docker/0123\n0::/docker/0123\n");
    root.add("sys/fs/cgroup/cpu/cpu.cfs_quota_us", "300000\n");
    root.add("sys/fs/cgroup/cpu/cpu.cfs_period_us", "100000\n");
    EXPECT_EQ(root.quota(), 3);
}

TEST(Machine, HasAProcessor) { EXPECT_GE(available_processors(), 1); }

} // namespace pathfold::core
