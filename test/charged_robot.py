# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A formula about the battery of a robot, for tests of verdicts."""

CHARGED = "Holds(charged, nao)"
FORMULAS = """
<transformations>
  <transformation type="topic"><label>battery</label><source>/battery</source>
    <ports><port type="out" datatype="sensor_msgs/BatteryState">out</port></ports>
    <tags><tag port="out">Battery(nao)</tag></tags></transformation>
  <transformation type="formula"><label>charged</label>
    <ports><port type="in" datatype="sensor_msgs/BatteryState">battery</port>
    <port type="out">holds</port></ports>
    <tags><tag port="battery">Battery(?robot)</tag>
    <tag port="holds">Holds(charged, ?robot)</tag></tags>
    <formula>battery.percentage &gt; 0.2</formula></transformation>
</transformations>
"""
