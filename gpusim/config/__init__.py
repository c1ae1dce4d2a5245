"""What every settings file shares: one loader, one strict base, one way to tell mistakes."""
