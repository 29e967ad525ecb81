// Prints where the robot is. Build and run it in this folder:
//
//     g++ -std=c++17 -O2 main.cpp -o where
//     curl -sN http://127.0.0.1:7000/events | ./where        # or: edge-vpr stream ... --json | ./where
//
// std::getline waits: a robot must also stop by itself when no match comes for a while.
#include <iostream>

#include "edge_vpr_match.hpp"

int main() {
    edge_vpr::Reader reader;
    for (std::string line; std::getline(std::cin, line);) {
        const auto match = reader.read(line);
        if (!match) continue;
        std::cout << match->time_s << " s: ";
        if (match->lost)
            std::cout << "lost";
        else if (match->along_m)
            std::cout << *match->along_m << " m along the route";
        else
            std::cout << "place " << match->place;
        std::cout << std::endl;
    }
    std::cerr << reader.refused << " lines refused\n";
}
