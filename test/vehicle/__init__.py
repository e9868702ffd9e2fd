"""What a ROS 2 integrator, a safety engineer and an attacker try on the nodes, from outside, each as a check with a
figure: `make vehicle`."""
