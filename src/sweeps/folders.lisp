;;; anmech: folders whose names others have chosen, and the files in them.
;;;
;;; Entry points: anmech_check_folder_name, anmech_check_plain_folder, anmech_file_text,
;;; anmech_write_whole, anmech_write_first, anmech_is_file, anmech_make_folder, anmech_last_line,
;;; anmech_package_checksum.

(in-package :anmech)
(needs "session/processes" "session/scripts" "session/texts" "session/whole_files" "arithmetic/checksums")

(defun plain-file-character-p (char)
  "What neither the shell, nor Maxima's strings, nor a Lisp's pathnames take for a sign of theirs."
  (or (alphanumericp char) (find char "/._-+,=@ ") (> (char-code char) 127)))

(maxima::defmfun maxima::$anmech_check_folder_name (folder)
  "anmech_check_folder_name(text): complains of one that some of the programs in use would take for something else."
  (unless (and (stringp folder) (plusp (length folder)))
    (complain "expected a folder as a string, found ~a" (one-line folder)))
  (let ((odd (find-if-not #'plain-file-character-p folder)))
    (when odd
      (complain "the name of the folder holds ~:[the character ~a~;a character of the number ~d~]; expected letters, ~
                 digits, spaces and / . _ - + , = @"
                (< (char-code odd) 32) (if (< (char-code odd) 32) (char-code odd) (string odd)))))
  (when (char= (char folder 0) #\-) (complain "the name of the folder begins with -"))
  (string-right-trim "/" folder))

(maxima::defmfun maxima::$anmech_check_plain_folder (folder)
  "anmech_check_plain_folder(folder): complains of one that holds links, pipes or devices where a sweep writes: through
them others could read and write elsewhere, or keep a reader waiting."
  (unless (maxima::$anmech_succeeds
           (format nil "[ -z \"$(find ~a/ -mindepth 1 -maxdepth 2 ! -type f ! -type d 2> /dev/null | head -n 1)\" ]"
                   (shell-word folder)))
    (complain "the folder ~a holds links, pipes or devices, which no sweep makes" folder)))

(maxima::defmfun maxima::$anmech_write_whole (file text)
  "anmech_write_whole(file, text): the file holds the text, or is as it was, and an error says so."
  (unless (write-whole-file file (teller-of (lines-in text))) (complain "cannot write the file ~a" file))
  file)

(maxima::defmfun maxima::$anmech_write_first (file text)
  "anmech_write_first(file, text): the file is there, and holds the text unless it was there already."
  (let* ((passing (passing-name file))
         (from (shell-word passing))
         (to (shell-word file)))
    (maxima::$anmech_write_whole passing text)
    (unless (maxima::$anmech_succeeds             ; not every file system has links
             (format nil "ln ~a ~a 2> /dev/null || [ -f ~a ] || mv ~a ~a; there=$?; rm -f ~a; exit $there"
                     from to to from to from))
      (complain "cannot write the file ~a" file))
    file))

(maxima::defmfun maxima::$anmech_file_text (file)
  "anmech_file_text(file): its text; false if it cannot be read."
  (let ((lines (lines-of-file file)))
    (and lines (coerce (format nil "~{~a~^~%~}" lines) 'simple-string))))

(maxima::defmfun maxima::$anmech_last_line (file)
  "anmech_last_line(file): the last line that holds more than spaces; an empty text if there is none."
  (coerce (or (find-if (lambda (line) (string/= "" (string-trim " " line))) (reverse (lines-of-file file))) "")
          'simple-string))

(maxima::defmfun maxima::$anmech_is_file (file)
  "anmech_is_file(file): whether it is there."
  (handler-case (and (probe-file file) t) (error () nil)))

(maxima::defmfun maxima::$anmech_make_folder (folder)
  "anmech_make_folder(text): it is there then."
  (unless (maxima::$anmech_succeeds (format nil "mkdir -p ~a 2> /dev/null" (shell-word folder)))
    (complain "cannot make the folder ~a" folder)))

(defun names-of-sources ()
  (sort (mapcar #'namestring (append (directory (source-file "**/*")) (directory (source-file "**/*" "c"))
                                     (directory (concatenate 'string *module-directory* "**/*.mac"))))
        #'string<))

(defun checksum-of-files (names)
  (let ((checksum 0) (root (length (maxima::$anmech_root_directory))))
    (dolist (name names checksum)
      (setq checksum (extended-checksum (subseq name root) checksum))
      (dolist (line (lines-of-file name)) (setq checksum (extended-checksum line checksum))))))

(defvar *package-checksum* nil
  "The names and dates of all sources, and their checksum, which an interpreted kernel takes seconds for.")

(maxima::defmfun maxima::$anmech_package_checksum ()
  "anmech_package_checksum(): of all sources of this package, in the order of their names."
  (let* ((names (names-of-sources))
         (state (mapcar (lambda (name) (cons name (file-write-date name))) names)))
    (unless (equal (car *package-checksum*) state)
      (setq *package-checksum* (cons state (checksum-text (checksum-of-files names)))))
    (cdr *package-checksum*)))
