"""The paper's statements checked one by one."""
