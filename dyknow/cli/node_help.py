# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""What `--help` prints for the nodes: what each is, its parameters, and its services."""

HELP = frozenset({"-h", "--help"})  # words that ask for it

_ROS_ARGUMENTS = """\
As everywhere in ROS, _PARAMETER:=VALUE sets a private parameter, __name:=NAME names the
node, and __ns:=NAMESPACE puts it into a namespace.
"""

MANAGER = f"""\
usage: manager [_PARAMETER:=VALUE ...] [__name:=NAME] [__ns:=NAMESPACE]

Run the DyKnow manager: it knows the transformations that can run, makes nodelets from
them, connects these, keeps requested streams, and brings dead nodelets back.
It starts a nodelet manager of its own.

Private parameters (default):
  ~num_nodelet_managers  nodelet managers of its own (1)
  ~nodelet_managers      names of further nodelet managers, Python or C++ (none)
  ~transformations       specification files (none)
  ~ontologies            ontology files for templates and tags (none)
  ~catalogues            XML catalogues of the ontologies that these import, beside the
                         catalog-v001.xml next to each file (none)
  ~language              language of the labels that are preferred as names (en)
  ~use_exports           whether specification files and ontologies that packages export
                         in package.xml are used too (true)
  ~wiring                file of 'dyknow save' to load at the start, unless the state that
                         is restored has it already (none)
  ~keep                  whether its nodelets and claims outlive an end on purpose, as
                         they outlive kill -9 (false)
  ~spawn_timeout         seconds that a nodelet may take to come up (10)
  ~orphan_timeout        seconds that its nodelet managers go on without it;
                         0: for ever (300)
  ~recover               seconds for which a verdict has to be TRUE again before the
                         transformations that require it are used (2)
  ~max_clock_offset      seconds by which the clock of another host may differ before
                         'dyknow doctor' and /diagnostics warn of it (0.1)
  ~shared_memory         whether its processes exchange large messages through shared
                         memory, where they can (true)
  ~watchdog/hung, ~watchdog/stuck, ~watchdog/memory
                         seconds without an answer, seconds for which a callback is
                         reported that does not return, and MB, after which a process
                         that the manager started is restarted (0: never)
  ~spread                auto: nodelets in Python that compute much are moved apart, over
                         at most as many nodelet managers as there are cores (none)
  ~spread_load           cores that the nodelets of one nodelet manager may take before
                         one of them is moved (0.7)
  ~state_dir             folder of the durable state (dyknow in ROS_HOME)
  ~denied_topics         patterns of topics that no port may be connected to (none)
  ~allowed_topics        patterns of the only topics that ports may be connected to (all)
  ~allowed_programs      patterns, such as my_robot/*, of the only programs and scripts
                         that may be started (all)
  ~remote_programs       whether services may start programs that no specification file
                         of the manager names (true)
  ~read_only             refuse every change (false)
  ~limits/string_length, ~limits/array_length, ~limits/nodelets, ~limits/text_size,
  ~limits/transformations
                         caps on what one request may contain and on what runs
                         (doc/security.md lists them)
A list is YAML, or words separated by white space.

Services:
  ~add_transformation, ~remove_transformation      the library
  ~spawn, ~destroy, ~set_protection, ~connect      nodelets
  ~restart, ~set_parameter
  ~get_model                                       what runs, and the library
  ~acquire_stream, ~renew_stream, ~release_stream  streams on request
  ~replan_stream, ~plan_stream, ~list_streams, ~find_bindings
  ~list_hosts                                      hosts, their load and clocks
Topics:
  ~model          the nodelets, latched, on every change
  ~stream_events  every change of a claim, with its reason
  ~counts         counts of messages and loads, while there are subscribers
  /diagnostics    the manager, its nodelets, claims and hosts

{_ROS_ARGUMENTS}
Examples:
  rosrun dyknow manager
  rosrun dyknow manager _transformations:=library.xml _num_nodelet_managers:=2
  roslaunch dyknow manager.launch transformations:=/path/to/library.xml

'rosrun dyknow dyknow --help' shows the command line that looks at it and changes it.
"""

NODELET_MANAGER = f"""\
usage: nodelet_manager [_PARAMETER:=VALUE ...] [__name:=NAME] [__ns:=NAMESPACE]

Run a nodelet manager: a process that hosts nodelets written in Python on threads, and
passes messages between them by reference. It is 'nodelet manager'; the stock command
line 'rosrun nodelet nodelet load PKG/CLASS NAME' works with it.

Private parameters (default):
  ~num_worker_threads  callbacks that can run at the same time; 0: the number of
                       cores, at least four (0)
  ~stuck_after         seconds after which a callback that has not returned is
                       reported (10)
  ~switch_interval     seconds that a thread in Python code keeps the interpreter
                       before others get it (0.0005)
  ~shared_memory       whether large messages reach other processes of this host
                       through shared memory, where they can (true)
  ~rewirable           whether its nodelets may be connected elsewhere; false: each
                       set_config is refused (true)

Services:
  ~load_nodelet, ~unload_nodelet, ~list            as the C++ nodelet manager has them
  /NODELET/get_config, set_config, get_statistics  the ports of each nodelet

{_ROS_ARGUMENTS}
Examples:
  rosrun dyknow nodelet_manager __name:=cameras
  rosrun dyknow nodelet load dyknow/Throttle cameras __name:=slow in:=/image _rate:=5
  roslaunch dyknow nodelet_manager.launch name:=cameras
"""
