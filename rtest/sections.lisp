;;;; sections.lisp: which verbs, tests and worksheets belong to each numbered section of the book.  For
;;;; rtest_sections.mac and make doc.
;;;;
;;;; sections.txt has the numbers with their titles, in English and, after |, in Chinese.  What belongs to them is read
;;;; off the files:
;;;;   verbs        the table at the head of a chapter's file, share/anmech/chNN_subject.mac: numbers, verbs, module
;;;;   tests        comments of rtest/rtest_*.mac: any that names a section, and headings, with dashes, that name groups
;;;;   worksheets   titles in examples/*.wxm that end with numbers in parentheses
;;;;   chapters     of the manual, where the verbs have their entries
;;;; Everywhere a number is a section, 18.1.1, or a group, 18.1, which stands for all its sections; "19.1.2 to 19.5.2"
;;;; is the second section of each group from 19.1 to 19.5, and any other range all sections between its ends.
;;;;
;;;;   sections_named(text)        the numbers of the sections that a text names
;;;;   sections_without(what)      the numbers of those without "verb", "test", "worksheet"
;;;;   sections_left_by([text, ..])   the numbers of those that no text names
;;;;   sections_unknown()          [file, number] of numbers in tables and worksheets that the book does not have
;;;;   sections_are_listed()       whether BOOK.md and the manual have the tables that the files make
;;;;   titles_lacking()            the numbers of sections whose title is missing in one of the two languages
;;;;   list_sections()             writes them

(in-package :anmech-tests)

(load (concatenate 'string *root* "rtest/sources.lisp"))

(defstruct section
  "NUMBER: a list of one, two or three integers, for a chapter, a group or a section."
  number title chinese history-p)

;;; Texts

(defun lines-of-file (file)
  "Its lines, each byte a letter, whatever the Lisp."
  (with-open-file (stream file #+(or sbcl ecl) :external-format #+(or sbcl ecl) :latin-1)
    (loop for line = (read-line stream nil) while line collect line)))

(defun code-points (bytes)
  "The numbers of the signs that BYTES, a text whose letters are bytes, stands for in UTF-8."
  (let ((points '()))
    (loop for letter across bytes
          for byte = (char-code letter)
          do (cond ((< byte #x80) (push byte points))
                   ((< byte #xC0) (setf (first points) (+ (ash (first points) 6) (logand byte #x3F))))
                   ((< byte #xE0) (push (logand byte #x1F) points))
                   (t (push (logand byte #x0F) points))))
    (reverse points)))

(defun for-html (bytes)
  "The same in ASCII, as HTML has it."
  (format nil "~{~a~}" (loop for point in (code-points bytes)
                             collect (if (and (< point #x80) (/= point (char-code #\,)))
                                         (code-char point)
                                         (format nil "&#~d;" point)))))

(defun text-within (file)
  (format nil "~{~a~%~}" (lines-of-file file)))

(defun base-name (file)
  "The name of a file, without its folder and its type."
  (subseq file (1+ (or (position #\/ file :from-end t) -1)) (position #\. file :from-end t)))

(defun own-path (file) (subseq file (length *root*)))

(defun ends-with (end text)
  (let ((start (- (length text) (length end))))
    (and (>= start 0) (string= end text :start2 start))))

;;; Numbers

(defun number-text (number) (format nil "~{~d~^.~}" number))

(defun number-parts (text)
  "The integers of a text such as 18.1.1; nil if it is no such text."
  (loop with start = 0
        for dot = (position #\. text :start start)
        for part = (subseq text start dot)
        unless (and (plusp (length part)) (every #'digit-char-p part)) do (return nil)
        collect (parse-integer part)
        while dot do (setq start (1+ dot))))

(defvar *sections* '())

(defun sections ()
  "All lines of sections.txt: chapters, groups and sections."
  (or *sections*
      (setq *sections*
            (loop for line in (lines-of-file (concatenate 'string *root* "rtest/sections.txt"))
                  for blank = (position #\Space line)
                  for bar = (search " | " line)
                  for title = (subseq line (1+ blank) bar)
                  collect (make-section :number (number-parts (subseq line 0 blank)) :title title
                                        :chinese (subseq line (+ bar 3)) :history-p (ends-with "(history)" title))))))

(defun proper-sections () (remove 3 (sections) :key (lambda (s) (length (section-number s))) :test #'/=))

(defun numbers-of (number)
  "The sections that a number stands for; nil if the book does not have it."
  (loop for section in (proper-sections)
        when (eql (mismatch number (section-number section)) (and (< (length number) 3) (length number)))
          collect (section-number section)))

(defun numbers-between (first last)
  (if (and (= (length first) 3) (= (length last) 3) (= (first first) (first last)) (= (third first) (third last)))
      (loop for group from (second first) to (second last)
            append (numbers-of (list (first first) group (third first))))
      (let ((start (first (numbers-of first))) (end (first (last (numbers-of last)))))
        (when (and start end)
          (loop for section in (member start (proper-sections) :key #'section-number :test #'equal)
                collect (section-number section)
                until (equal end (section-number section)))))))

(defun words-with-numbers (text)
  "The words of TEXT, what stands about them taken off."
  (loop with start = 0
        for end = (position-if (lambda (c) (find c '(#\Space #\Newline #\Tab))) text :start start)
        for word = (string-trim ",;:.()*/" (subseq text start end))
        unless (string= word "") collect word
        while end do (setq start (1+ end))))

(defun book-number (word)
  "The number of a chapter's group or section that WORD may be."
  (let ((parts (number-parts word)))
    (and (<= 2 (length parts) 3) (<= 14 (first parts) 25) parts)))

(defun references (text)
  "A list of (number) or (first last), for each number or range that TEXT names."
  (let ((words (words-with-numbers text)))
    (loop while words
          for number = (book-number (pop words))
          when number
            collect (let ((last (and (equal (first words) "to") (second words) (book-number (second words)))))
                      (cond (last (setq words (cddr words)) (list number last))
                            (t (list number)))))))

(defun sections-in (reference)
  (if (rest reference) (numbers-between (first reference) (second reference)) (numbers-of (first reference))))

(defun sections-named (text)
  (remove-duplicates (loop for reference in (references text) append (sections-in reference)) :test #'equal))

;;; What belongs to a section.  Each is a list of (numbers . things), where numbers are those of sections.

(defun chapter-files () (files-of "share/anmech/ch*_*.mac"))

(defun rows-of-table (file)
  "The lines of the table at the head of FILE, as (numbers-text . rest); where a row goes on, the text is that of its
beginning."
  (let ((lines (rest (member-if (lambda (line) (and (search "section " line) (search " verb" line)))
                                (lines-of-file file))))
        (numbers ""))
    (loop for line in lines
          for text = (string-left-trim " " line)
          until (string= text "")
          collect (let ((blanks (search "  " text)))
                    (if (< (- (length line) (length text)) 4)
                        (setq numbers (subseq text 0 blanks))
                        (setq blanks 0))
                    (cons numbers (subseq text (or blanks (length text))))))))

(defun name-character-p (c) (or (alphanumericp c) (char= c #\_)))

(defun verbs-in (text)
  (let ((verbs (mapcar (lambda (verb) (subseq (string-downcase (symbol-name verb)) 1))
                       (rest (maxima::mfuncall 'maxima::$anmech_verbs)))))
    (loop with start = 0
          for from = (position-if #'name-character-p text :start start)
          while from
          for to = (or (position-if-not #'name-character-p text :start from) (length text))
          for word = (subseq text from to)
          when (member word verbs :test #'string=) collect word
          do (setq start to))))

(defun verbs-of-sections ()
  (loop for file in (chapter-files)
        append (loop for (numbers . text) in (rows-of-table file)
                     collect (cons (sections-named numbers) (verbs-in text)))))

(defun heading-p (comment) (search "----" comment))

(defun comments-of (text)
  "The comments of Maxima in TEXT."
  (loop with start = 0
        for from = (search "/*" text :start2 start)
        for to = (and from (search "*/" text :start2 from))
        while to
        collect (subseq text (+ 2 from) to)
        do (setq start (+ 2 to))))

(defun sections-of-comment (comment)
  "A group counts only in a heading: elsewhere its number may be that of an example."
  (loop for reference in (references comment)
        when (or (= (length (first reference)) 3) (heading-p comment))
          append (sections-in reference)))

(defun tests-of-sections ()
  (loop for file in (files-of "rtest/rtest_*.mac")
        collect (list (mapcan #'sections-of-comment (rest (comments-of (text-within file)))) (own-path file))))

(defun worksheet-titles (file)
  "The titles in a worksheet: of itself and of its sections."
  (loop for (opening title) on (lines-of-file file)
        when (and title (search "[wxMaxima: " opening) (ends-with " start ]" opening)
                  (some (lambda (kind) (search kind opening)) '("title" "section" "subsect" "heading")))
          collect title))

(defun numbers-of-title (title)
  "What stands in parentheses at its end."
  (let ((from (position #\( title :from-end t)))
    (if (and from (ends-with ")" (string-right-trim " " title))) (subseq title from) "")))

(defun worksheets-of-sections ()
  (loop for file in (files-of "examples/*.wxm")
        collect (list (mapcan (lambda (title) (sections-named (numbers-of-title title))) (worksheet-titles file))
                      (own-path file))))

(defun things-of (number table)
  (remove-duplicates (loop for (numbers . things) in table
                           when (member number numbers :test #'equal) append things)
                     :test #'string= :from-end t))

(defun table-of (what)
  (cond ((string= what "verb") (verbs-of-sections))
        ((string= what "test") (tests-of-sections))
        (t (worksheets-of-sections))))

(defun sections-without (table)
  (loop for section in (proper-sections)
        unless (or (section-history-p section) (things-of (section-number section) table))
          collect (number-text (section-number section))))

(defun unknown-numbers ()
  (flet ((unknown (file text)
           (loop for reference in (references text)
                 unless (sections-in reference)
                   collect (maxima-list-with (list (own-path file) (number-text (first reference)))))))
    (append (loop for file in (chapter-files)
                  append (loop for (numbers) in (rows-of-table file) append (unknown file numbers)))
            (loop for file in (files-of "examples/*.wxm")
                  append (loop for title in (worksheet-titles file)
                               append (unknown file (numbers-of-title title)))))))

(defun maxima-list-with (items) (cons '(maxima::mlist maxima::simp) items))

;;; The chapters of the manual

(defun manual-texts ()
  "The lines of the manual, those of the files that it includes in their place."
  (let ((folder (concatenate 'string *root* "share/anmech/")))
    (loop for line in (lines-of-file (concatenate 'string folder "anmech.texi"))
          append (if (eql 0 (search "@include " line))
                     (lines-of-file (concatenate 'string folder (subseq line 9)))
                     (list line)))))

(defun chapters-of-verbs ()
  "A table: the chapter of each verb."
  (let ((node nil) (heading "@deffn {Function} ") (chapters (make-hash-table :test #'equal)))
    (dolist (line (manual-texts) chapters)
      (when (and (plusp (length line)) (char= (char line 0) #\@))
        (cond ((eql 0 (search "@node " line)) (setq node (subseq line 6)))
              ((eql 0 (search heading line))
               (setf (gethash (subseq line (length heading) (position #\Space line :start (length heading))) chapters)
                     node)))))))

;;; The tables of BOOK.md and of the manual

(defvar *tables* nil "(verbs tests worksheets)")
(defvar *chapters* nil "A table: the chapter of the manual that each verb has its entry in.")

(defun things-of-section (section)
  "(verbs tests worksheets chapters)"
  (let ((things (mapcar (lambda (table) (things-of (section-number section) table)) *tables*)))
    (append things
            (list (remove-duplicates (loop for verb in (first things)
                                           collect (gethash verb *chapters*))
                                     :test #'string= :from-end t)))))

(defun chapters ()
  "A list of (chapter . groups and sections)."
  (let ((chapters '()))
    (dolist (section (sections) (mapcar #'reverse (reverse chapters)))
      (if (rest (section-number section))
          (push section (first chapters))
          (push (list section) chapters)))))

(defun titled (section) (format nil "~a ~a" (number-text (section-number section)) (section-title section)))

(defun linked (files)
  (format nil "~{~a~^, ~}" (mapcar (lambda (file) (format nil "[~a](~a)" (short-file-name file) file)) files)))

(defun short-file-name (file)
  (let ((name (base-name file)))
    (if (eql 0 (search "rtest_" name)) (subseq name 6) name)))

(defun short-chapter (chapter)
  (subseq chapter 0 (search " in anmech" chapter)))

(defun book-row (section)
  (destructuring-bind (verbs tests worksheets chapters) (things-of-section section)
    (let ((number (number-text (section-number section))) (title (section-title section))
          (chinese (section-chinese section)))
      (if (= (length (section-number section)) 2)
          (format nil "| **~a** | **~a**<br>**~a** | | | | |" number title chinese)
          (format nil "| ~a | ~a<br>~a | ~{`~a`~^, ~} | ~{~a~^, ~} | ~a | ~a |" number title chinese verbs
                  (mapcar #'short-chapter chapters) (linked tests) (linked worksheets))))))

(defun book-tables ()
  (format nil "~{~a~^~%~}"
          (loop for (chapter . parts) in (chapters)
                collect (format nil "<details><summary>~a &nbsp; ~a</summary>~%~%~
                                     | section | | verbs | chapter of the manual | tests | worksheets |~%~
                                     |---|---|---|---|---|---|~%~
                                     ~{~a~%~}~%</details>~%"
                                (titled chapter) (section-chinese chapter) (mapcar #'book-row parts)))))

(defun manual-title (section)
  "In HTML with the Chinese title: neither info files nor TeX take that."
  (format nil "~a@inlineraw{html, <br>~a}" (section-title section) (for-html (section-chinese section))))

(defun manual-row (section)
  (destructuring-bind (verbs tests worksheets chapters) (things-of-section section)
    (let ((number (number-text (section-number section))) (title (manual-title section)))
      (if (= (length (section-number section)) 2)
          (format nil "@item ~a @tab @strong{~a}" number title)
          (format nil "@item ~a @tab ~a~%@tab ~{@code{~a}~^, ~}~%@tab ~{@ref{~a}~^, ~}~%@tab ~{~a~^, ~}" number title
                  verbs chapters (mapcar #'base-name (append tests worksheets)))))))

(defun manual-tables ()
  (format nil "@c Written by make doc (rtest/sections.lisp).~%~{~a~^~%~}"
          (loop for (chapter . parts) in (chapters)
                collect (format nil "@heading ~a~%@multitable @columnfractions .08 .24 .28 .22 .18~%~
                                     ~{~a~%~}@end multitable~%"
                                (format nil "~a ~a" (number-text (section-number chapter)) (manual-title chapter))
                                (mapcar #'manual-row parts)))))

(defun book-file () (concatenate 'string *root* "BOOK.md"))
(defun tables-file () (concatenate 'string *root* "share/anmech/sections.texi"))

(defun book-with-tables ()
  (let* ((text (text-within (book-file))) (opening (format nil "<!-- sections -->~%"))
         (start (+ (search opening text) (length opening)))
         (end (search "<!-- end of sections -->" text)))
    (concatenate 'string (subseq text 0 start) (book-tables) (subseq text end))))

(defmacro with-tables (&body body)
  `(let ((*tables* (mapcar #'table-of '("verb" "test" "worksheet"))) (*chapters* (chapters-of-verbs))) ,@body))

(defun sections-are-listed ()
  (with-tables
    (and (string= (text-within (book-file)) (book-with-tables))
         (string= (text-within (tables-file)) (manual-tables)))))

(defun list-sections ()
  (with-tables
    (let ((book (book-with-tables)) (manual (manual-tables)))
      (loop for (file text) in (list (list (book-file) book) (list (tables-file) manual))
            do (with-open-file (stream file :direction :output :if-exists :supersede
                                            #+(or sbcl ecl) :external-format #+(or sbcl ecl) :latin-1)
                 (write-string text stream))))))

(defun titles-lacking ()
  (loop for section in (sections)
        unless (and (string/= (section-title section) "")
                    (some (lambda (point) (<= #x4E00 point #x9FFF)) (code-points (section-chinese section))))
          collect (number-text (section-number section))))

(in-package :maxima)

(defmfun $sections_named (text)
  (anmech-tests::maxima-list-with
   (mapcar #'anmech-tests::number-text (anmech-tests::sections-named text))))
(defmfun $sections_without (what)
  (anmech-tests::maxima-list-with (anmech-tests::sections-without (anmech-tests::table-of what))))
(defmfun $sections_left_by (texts)
  (anmech-tests::maxima-list-with
   (anmech-tests::sections-without
    (mapcar (lambda (text) (list (anmech-tests::sections-named text) text)) (rest texts)))))
(defmfun $sections_unknown () (anmech-tests::maxima-list-with (anmech-tests::unknown-numbers)))
(defmfun $sections_are_listed () (anmech-tests::sections-are-listed))
(defmfun $titles_lacking () (anmech-tests::maxima-list-with (anmech-tests::titles-lacking)))
(defmfun $list_sections () (anmech-tests::list-sections) '$done)
